#!/bin/sh
# ExtraNet from nothing: training clips rendered, the network trained, the result compared on held-out scenes.
#
#     examples/train_extranet.sh [folder] [steps]
#
# Interrupted and started again it goes on where it was. With 2 steps it runs in minutes on a CPU; good results take
# some ten thousand steps on a GPU (set DEVICE=cuda).
set -e
out=${1:-runs/extranet}
steps=${2:-12000}
device=${DEVICE:-cpu}

for seed in 0 1 2; do
  for scene in courtyard workshop gallery tramway neon forest; do
    framecast render "$scene" -o "$out/clips/train/$scene-$seed" --seed "$seed" --size 640x360 --scale 1 --samples 0
  done
done
for scene in harbor greenhouse hangar clockwork pond; do
  framecast render "$scene" -o "$out/clips/test/$scene" --size 640x360 --scale 1 --samples 0
done

framecast train extranet --clips "$out/clips/train/*" --out "$out/run" --steps "$steps" --device "$device"
framecast evaluate "$out"/clips/test/* --mode extrapolate --methods warp,warp-occlusion --json "$out/baselines.json"
