#!/bin/sh
# ExtraNet from nothing: clips rendered, the network trained, the result compared on held-out scenes.
#
#     examples/train_extranet.sh [folder] [steps]
#
# Interrupted and started again it goes on where it was. With 2 steps and SMALL=1 it runs in minutes on a CPU; set
# DEVICE=cuda where there is a GPU.
set -e
out=${1:-runs/extranet}
steps=${2:-9000}
device=${DEVICE:-cpu}
seeds=${SMALL:+0}
frames=${SMALL:+8}

# Half of the clips with jitter, half without, so that the network serves both.
for seed in ${seeds:-0 1 2 3}; do
  jitter=$([ "$seed" -lt 2 ] && echo --jitter || echo --no-jitter)
  for scene in courtyard workshop gallery tramway neon forest; do
    framecast render "$scene" -o "$out/clips/train/$scene-$seed" --seed "$seed" --size 320x180 --scale 1 \
      --samples 0 --frames "${frames:-32}" "$jitter"
  done
done
# Random worlds, each another: what keeps the network from learning six scenes by heart.
for seed in ${seeds:-$(seq 0 49)}; do
  jitter=$([ $((seed % 3)) -eq 0 ] && echo --jitter || echo --no-jitter)
  framecast render medley -o "$out/clips/train/medley-$seed" --seed "$seed" --size 320x180 --scale 1 --samples 0 \
    --frames "${frames:-16}" "$jitter"
done
for scene in harbor greenhouse hangar clockwork pond; do
  framecast render "$scene" -o "$out/clips/test/$scene" --size 320x180 --scale 1 --samples 1 --frames "${frames:-25}" \
    --no-jitter
done

framecast train extranet --clips "$out/clips/train/*" --out "$out/run" --steps "$steps" --device "$device"
framecast evaluate "$out"/clips/test/* --mode extrapolate \
  --methods "warp,warp-occlusion,extranet=$out/run/weights.safetensors" --json "$out/results.json"
