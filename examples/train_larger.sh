#!/bin/sh
# A network that makes frames larger, from nothing: clips rendered, the network trained, the result compared on held-out
# scenes with what needs no training.
#
#     examples/train_larger.sh classifier|extrass|fasset|nsrr|mnss [folder] [steps]
#
# Interrupted and started again it goes on where it was; the clips serve every one of these methods. SMALL=1 and 2 steps
# try it out, on smaller and fewer clips; set DEVICE=cuda where there is a GPU.
set -e
method=${1:?which network: classifier, extrass, fasset, nsrr or mnss}
out=${2:-runs/larger}
steps=${3:-4000}
size=${SMALL:+96x54}
frames=${SMALL:+8}
samples=${SMALL:+2}

# Random worlds beside the six scenes, each another: what keeps the network from learning six scenes by heart.
render() {
  framecast render "$1" -o "$out/clips/$2" --seed "$3" --size "${size:-256x144}" --scale 2 --samples "${samples:-8}" \
    --frames "${frames:-16}" --ranges
}
for scene in courtyard workshop gallery tramway neon forest; do
  render "$scene" "train/$scene" 4
done
for seed in ${SMALL:-20 21 22 23 24 25 26 27 28 29 30 31 32 33}; do
  render medley "train/medley-$seed" "$seed"
done
for scene in harbor greenhouse hangar clockwork pond; do
  render "$scene" "test/$scene" 0
done

case $method in
  extrass | fasset) mode=extrapolate others=extrass-warp+bilinear,extrass-warp+taau ;;
  *) mode=pass others=bilinear,taau ;;
esac
framecast train "$method" --clips "$out/clips/train/*" --out "$out/$method" --steps "$steps" --device "${DEVICE:-cpu}"
framecast evaluate "$out"/clips/test/* --mode "$mode" --scale 2 \
  --methods "$others,$method=$out/$method/weights.safetensors" --json "$out/$method.json"
