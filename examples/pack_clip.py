"""Make a clip small enough to ship: fewer buffers, and no more digits than a method can use.

python examples/pack_clip.py CLIP OUT [--frames 9]

Colour keeps 8 bits of mantissa (steps of 0.2 to 0.4 %), depth is a half float, motion is rounded to 1/64 pixel.
"""

import argparse
from pathlib import Path

import numpy as np

from framecast.clip import finish, write_frame
from framecast.importers import open_any

KEPT = ("color", "depth", "motion", "motion_next", "object")


def rounded(name: str, pixels: np.ndarray) -> np.ndarray:
    """Values with fewer digits, so that they compress."""
    if name == "color":
        half = pixels.astype(np.float16).view(np.uint16).astype(np.uint32)
        return np.minimum((half + 2) & ~np.uint32(3), 0x7BFF).astype(np.uint16).view(np.float16)
    return np.round(pixels * 64) / 64 if name.startswith("motion") else pixels


def main() -> None:
    """See the top of this file."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("clip", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--frames", type=int, default=9)
    arguments = parser.parse_args()
    clip = open_any(arguments.clip)
    for record in clip.records[: arguments.frames]:
        layers = {name: rounded(name, pixels) for name, pixels in clip.checked(record).items() if name in KEPT}
        write_frame(arguments.out, record, layers, half=frozenset(KEPT))
    finish(arguments.out, fps=clip.fps, span=clip.span, provenance=clip.provenance)
    size = sum(path.stat().st_size for path in arguments.out.rglob("*.exr"))
    print(f"{arguments.out}: {min(arguments.frames, len(clip))} frames, {size / 1e6:.1f} MB")


if __name__ == "__main__":
    main()
