"""Print docs/conventions.md from the code: python docs/conventions.py"""

from dataclasses import fields
from pathlib import Path

from framecast.clip import HALF, ON_DISK
from framecast.frame import BUFFERS, Frame

HEAD = """# Conventions

Printed from `framecast/frame.py` by `make docs`. Inside the package there is this one convention; what engines and
renderers write is converted where files are read. Each row has an executable law in `tests/test_conventions.py`.

Pixel (column i, row j) has its centre at (i + 0.5, j + 0.5); x points right, y points down. World space is
right-handed; a camera looks down its own -z with +y up. Matrices act on column vectors.

## Fields of a frame

| field | unit | meaning |
|---|---|---|
"""

DISK = """
## A clip on disk

`clip.json` holds the frame rate, the size, how far vectors reach (`motion_span`) and, per frame, number, time, jitter,
cameras, cuts and exposure. Each frame is one EXR file, `frames/0007.exr`; without `R G B` it is an unshaded one.
`reference/0007.exr` is what a method should have made, at display size.

| buffer | channels | stored as |
|---|---|---|
"""


def page() -> str:
    """The page as Markdown."""
    rows = [f"| `{f.name}` | {f.metadata['unit']} | {f.metadata['meaning']} |" for f in fields(Frame)]
    kinds = {name: "half float" if name in HALF else "32-bit float" for name in ON_DISK} | {"object": "32-bit integer"}
    disk = [f"| `{name}` | {' '.join(f'`{c}`' for c in ON_DISK[name])} | {kinds[name]} |" for name in ON_DISK]
    assert set(BUFFERS) <= set(ON_DISK)
    return HEAD + "\n".join(rows) + "\n" + DISK + "\n".join(disk) + "\n"


if __name__ == "__main__":
    Path(__file__).with_suffix(".md").write_text(page())
