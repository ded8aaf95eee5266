"""Why history may fail at a pixel, and where one sample a pixel is not enough: true classes, from what pixels hold.

Source: Guo, Chen, Dong, Tong, "Classifier Guided Temporal Supersampling for Real-time Rendering", Computer Graphics
        Forum 41(7), 2022, supplement, section 2: its tests in its order, its thresholds.

They need the range of depth and colour, and the spread of normals, over many samples of every display pixel, which
`framecast render ... --ranges` writes. Each pixel has one of GHOSTING and one of ALIASING.

Choices where the supplement is silent or cannot be meant as printed:
  Eq. 1 compares depths of two frames. It prints the earlier frame twice; one of them is the current one.
  Beyond the screen, after a cut and on the first frame there is no history at all: visibility everywhere.
  Before a cut nothing has a velocity, so that on the second frame of a shot depth alone decides.
  Dilation (Eq. 3, 4) goes from a labelled pixel to neighbours in front of it that move otherwise: edge pixels of what
  uncovers a surface hold some of that surface, and their nearest sample does not tell.
  Colours are compared as c / (1 + c) per channel, which maps boxes to boxes, with T_I = 0.03 either way and in any
  channel, and T_IoU = 0.25. Boxes grow by SLACK first: those of uniform pixels have no volume.
  An opening done again changes nothing, so that it is done once, with 3 x 3 pixels. Against the exact changes of light
  above 5 % that the renderer writes, where nothing else is labelled, in six training clips at 512x288 to 640x360:
  precision 0.84 and recall 0.49; with T_I = 0.1 next to nothing is found; with 5 x 5 pixels it is 0.94 and 0.23.
  Eq. 7 asks whether depth varies by 1 % inside a pixel, which all of a floor does up to 100 pixels below the horizon,
  at any resolution: shadows that move there would never be shading. What a plane spans is taken off first (`_slope`).
  Eq. 9 divides by at least DARK, or the faintest light in a black channel would be texture.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float, UInt8
from PIL import Image, ImageDraw, ImageFont
from torch import Tensor
from tyro.conf import Positional, arg

from framecast import exr
from framecast.clip import Clip, ClipError, open_clip
from framecast.color import to_display
from framecast.frame import inverse_depth
from framecast.warp import fetch, inside

GHOSTING = ("visibility", "shading", "none")
ALIASING = ("geometry", "texture", "none")
NONE = 2
"""Index of "none" in both."""

RULES = 2
"""Counts the changes of what these tests say, so that labels kept in caches are made anew."""

DEPTH = 0.01
"""Part of its reversed depth by which a surface is another one: of two frames, two pixels, or one pixel."""
VELOCITY = 1.0
"""Squared difference of two velocities, display pixels a frame, above which they are of different surfaces."""
COLOR, OVERLAP = 0.03, 0.25
"""Change of the brightest sample that counts, and the overlap of colour boxes below which it does."""
SLACK = 0.01
"""By which colour boxes grow on every side before they are compared."""
NORMAL, CONTRAST = 0.5, 0.5
"""Spread of normals, and difference of brightest and darkest sample relative to the brightest, inside one pixel."""
DARK = 0.02
"""Smallest brightness that differences are divided by, scene-linear."""

COLORS = {
    "visibility": (230, 40, 60),
    "shading": (60, 130, 255),
    "geometry": (40, 200, 120),
    "texture": (250, 190, 40),
}
"""What pictures show a class in."""


@dataclass(frozen=True)
class Ranges:
    """What varies inside the pixels of one frame, over all their samples, at display size."""

    low: Float[Tensor, "b 3 H W"]
    """Darkest colour, channel by channel, scene-linear."""
    high: Float[Tensor, "b 3 H W"]
    """Brightest colour."""
    near: Float[Tensor, "b 1 H W"]
    """Smallest depth, scene units; SKY where nothing was hit."""
    far: Float[Tensor, "b 1 H W"]
    """Largest depth."""
    bent: Float[Tensor, "b 1 H W"]
    """Largest sum of absolute differences between the first sample's normal and any other's, normal maps included."""
    turned: Float[Tensor, "b 1 H W"]
    """The same of the surfaces' own normals."""


@dataclass(frozen=True)
class Labels:
    """Classes of the pixels of one frame."""

    ghosting: UInt8[Tensor, "b 1 H W"]
    """Index into GHOSTING."""
    aliasing: UInt8[Tensor, "b 1 H W"]
    """Index into ALIASING."""


def likeliest(classes: Float[Tensor, "b 6 H W"]) -> Labels:
    """The classes whose likelihoods, or logits, are largest: three of GHOSTING, then three of ALIASING."""
    ghosting, aliasing = (three.argmax(1, keepdim=True).to(torch.uint8) for three in classes.chunk(2, 1))
    return Labels(ghosting, aliasing)


# The tests.


def classify(
    now: Ranges,
    before: Ranges | None,
    motion: Float[Tensor, "b 2 H W"],
    motion_before: Float[Tensor, "b 2 H W"] | None = None,
) -> Labels:
    """The classes of a frame, in the supplement's order: visibility, shading, aliasing, corrections.

    Args:
        before: the frame before; None after a cut.
        motion: to the frame before, display pixels.
        motion_before: that frame's own; None where it has none.
    """
    geometry, texture = aliasing(now)
    hidden, changed = torch.ones_like(geometry), torch.zeros_like(geometry)
    if before is not None:
        hidden = visibility(now, before, motion, motion_before)
        changed = shading(now, before, motion) & ~hidden & ~geometry & ~texture
    return Labels(_coded(hidden, changed), _coded(geometry, texture))


def _coded(first: Tensor, second: Tensor) -> UInt8[Tensor, "b 1 H W"]:
    return torch.where(first, 0, torch.where(second, 1, NONE)).to(torch.uint8)


def visibility(
    now: Ranges, before: Ranges, motion: Float[Tensor, "b 2 H W"], motion_before: Float[Tensor, "b 2 H W"] | None
) -> Bool[Tensor, "b 1 H W"]:
    """Where the frame before showed something nearer that moved otherwise, or nothing: it was off the screen."""
    here, there = inverse_depth(now.near), fetch(inverse_depth(before.near), motion)
    hidden = there - here > DEPTH * there
    if motion_before is not None:
        hidden = hidden & (_apart(motion, fetch(motion_before, motion)) > VELOCITY)
    return _grown(hidden, here, motion) | ~inside(motion)


def _apart(a: Tensor, b: Tensor) -> Float[Tensor, "b 1 H W"]:
    """Squared length of the difference of vectors."""
    return (a - b).square().sum(1, keepdim=True)


def _grown(hidden: Tensor, nearness: Tensor, motion: Tensor) -> Bool[Tensor, "b 1 H W"]:
    """The label also on pixels in front of a labelled one among the eight around them that moves otherwise."""
    height, width = hidden.shape[-2:]
    around = F.pad(torch.cat((hidden.float(), nearness, motion), 1), (1, 1, 1, 1), mode="replicate")
    grown = hidden
    for dy in range(3):
        for dx in range(3):
            label, other, velocity = around[..., dy : dy + height, dx : dx + width].split((1, 1, 2), 1)
            in_front = (nearness - other > DEPTH * nearness) & (_apart(motion, velocity) > VELOCITY)
            grown = grown | ((label > 0) & in_front)
    return grown


def shading(now: Ranges, before: Ranges, motion: Float[Tensor, "b 2 H W"]) -> Bool[Tensor, "b 1 H W"]:
    """Where light changed on areas of at least 3 x 3 pixels; what lies beyond the border counts as changed."""
    low, high = _bounded(now.low), _bounded(now.high)
    low_before, high_before = fetch(torch.cat((_bounded(before.low), _bounded(before.high)), 1), motion).chunk(2, 1)
    changed = (high - high_before).abs().amax(1, keepdim=True) > COLOR
    changed = changed & (_overlap(low, high, low_before, high_before) < OVERLAP)
    return opened(changed)


def _bounded(color: Tensor) -> Tensor:
    """c / (1 + c) per channel."""
    return color / (1 + color)


def _overlap(low: Tensor, high: Tensor, low_before: Tensor, high_before: Tensor) -> Float[Tensor, "b 1 H W"]:
    """Volume that two boxes of colours share, as a part of what they fill together."""
    shared = torch.minimum(high, high_before) - torch.maximum(low, low_before) + 2 * SLACK
    both = shared.clamp(min=0).prod(1, keepdim=True)
    one, other = ((b - a + 2 * SLACK).prod(1, keepdim=True) for a, b in ((low, high), (low_before, high_before)))
    return both / (one + other - both)


def opened(mask: Bool[Tensor, "b 1 H W"]) -> Bool[Tensor, "b 1 H W"]:
    """Erosion and dilation by 3 x 3 pixels: what is less than 3 pixels wide goes, the rest stays."""
    eroded = -F.max_pool2d(-mask.float(), 3, 1, 1)
    return F.max_pool2d(eroded, 3, 1, 1) > 0.5


def aliasing(now: Ranges) -> tuple[Bool[Tensor, "b 1 H W"], Bool[Tensor, "b 1 H W"]]:
    """Where depth or surface normals vary inside a pixel, and where only bent normals or colours do."""
    near, far = inverse_depth(now.near), inverse_depth(now.far)
    depth = near - far - _slope(near) > DEPTH * near
    geometry = depth | (now.turned > NORMAL)
    contrast = ((now.high - now.low) / now.high.clamp(min=DARK)).amax(1, keepdim=True) > CONTRAST
    return geometry, (depth | (now.bent > NORMAL) | contrast) & ~geometry


def _slope(nearness: Tensor) -> Float[Tensor, "b 1 H W"]:
    """What reversed depth changes by from pixel to pixel, on the flatter side of each axis, both axes together: what
    one pixel of a plane spans, and 0 beside an edge."""
    total = torch.zeros_like(nearness)
    for axis, before, after in ((-1, (1, 0), (0, 1)), (-2, (0, 0, 1, 0), (0, 0, 0, 1))):
        change = nearness.diff(dim=axis).abs()
        total = total + torch.minimum(*(F.pad(change, side, value=torch.inf) for side in (before, after)))
    return total


# Clips.


def read_ranges(clip: Clip, index: int) -> Ranges:
    """The ranges of a frame of a clip.

    Raises:
        ClipError: the clip has none, or they are damaged.
    """
    path = clip.path / "ranges" / f"{clip.shown[index].number:04d}.exr"
    if not path.is_file():
        raise ClipError(
            f"{clip.path} has no sample ranges (no {path.relative_to(clip.path)}), from which labels are made; "
            f"render them with the clip: framecast render SCENE -o CLIP --ranges"
        )
    channels = exr.read(path).channels
    try:
        low, high = (_planes(*(channels[f"color_{end}.{c}"] for c in "RGB")) for end in ("min", "max"))
        rest = [_planes(channels[c]) for c in ("depth_min.Z", "depth_max.Z", "normal_spread.Y", "geometric_spread.Y")]
    except KeyError as error:
        raise ClipError(f"{path} has no channel {error.args[0]}; render the clip again with --ranges") from error
    return Ranges(low, high, *rest)


def read_motion(clip: Clip, index: int) -> Float[Tensor, "1 2 H W"]:
    """Exact motion of a frame to the one before, at display size.

    Raises:
        ClipError: the clip has none.
    """
    path = clip.path / "masks" / f"{clip.shown[index].number:04d}.exr"
    if not path.is_file():
        raise ClipError(
            f"{clip.path} has no motion at display size (no {path.relative_to(clip.path)}), from which labels are "
            f"made; render the clip again: framecast render SCENE -o CLIP --ranges"
        )
    channels = exr.read(path).channels
    return _planes(channels["motion.X"], channels["motion.Y"])


def _planes(*planes: np.ndarray) -> Float[Tensor, "1 c H W"]:
    return torch.from_numpy(np.stack(planes).astype(np.float32))[None]


def labels(clip: Clip, index: int) -> Labels:
    """The classes of a frame of a clip at its full rate.

    Raises:
        ClipError: the clip has no ranges.
    """
    now, motion = read_ranges(clip, index), read_motion(clip, index)
    if clip.is_cut(index):
        return classify(now, None, motion)
    earlier = None if clip.is_cut(index - 1) else read_motion(clip, index - 1)
    return classify(now, read_ranges(clip, index - 1), motion, earlier)


# Pictures.


def overlay(image: Float[Tensor, "1 3 H W"], found: Labels) -> UInt8[np.ndarray, "H 2*W 3"]:
    """The picture in grey twice, side by side: ghosting in colours on the left, aliasing on the right."""
    grey = (to_display(image.float()).mean(1) * 150 + 40)[0].cpu().numpy()[..., None].repeat(3, 2)
    halves = []
    for classes, names in ((found.ghosting, GHOSTING), (found.aliasing, ALIASING)):
        half, which = grey.copy(), classes[0, 0].cpu().numpy()
        for k, name in enumerate(names[:NONE]):
            half[which == k] = 0.35 * half[which == k] + 0.65 * np.array(COLORS[name])
        halves.append(half)
    return (np.concatenate(halves, 1) + 0.5).astype(np.uint8)


def show(image: Float[Tensor, "1 3 H W"], found: Labels, path: Path) -> None:
    """Writes the overlay as PNG, the whole file or nothing."""
    with exr.whole(path) as temporary:
        titled(overlay(image, found), found).save(temporary, format="PNG")


def titled(picture: UInt8[np.ndarray, "H W 3"], found: Labels) -> Image.Image:
    """The overlay under a line that names the colours and says how many of the pixels have them."""
    height, width, _ = picture.shape
    size = max(10, min(20, width // 50))
    font, bar = ImageFont.load_default(size), size + 10
    page = Image.new("RGB", (width, height + bar), (24, 24, 27))
    page.paste(Image.fromarray(picture), (0, bar))
    pen = ImageDraw.Draw(page)
    for half, (title, classes, names) in enumerate(
        (("ghosting", found.ghosting, GHOSTING), ("aliasing", found.aliasing, ALIASING))
    ):
        x = half * width / 2 + 6
        for text, color in ((title, (235, 235, 235)), *_legend(classes, names)):
            pen.text((x, 4), text, fill=color, font=font)
            x += pen.textlength(text, font=font) + size
    return page


def _legend(classes: Tensor, names: tuple[str, ...]) -> list[tuple[str, tuple[int, int, int]]]:
    share = [float((classes == k).float().mean()) for k in range(NONE)]
    return [(f"{name} {100 * part:.1f} %", COLORS[name]) for name, part in zip(names, share, strict=False)]


def command(clip: Positional[Path], out: Annotated[Path, arg(aliases=["-o"])], frame: int | None = None) -> None:
    """Show the true classes of the pixels of a frame: where history fails, and where one sample is not enough.

    Args:
        clip: a clip rendered with --ranges.
        out: a picture, such as labels.png.
        frame: number of the frame; by default the one in the middle.
    """
    opened_clip = open_clip(clip)
    numbers = [record.number for record in opened_clip.shown]
    if len(numbers) < 2:
        raise ClipError(f"{clip} holds one frame, which has no history to fail; labels need at least two frames")
    number = numbers[len(numbers) // 2] if frame is None else frame
    if number not in numbers:
        raise ClipError(f"{clip} has no frame {number} (it has {numbers[0]} to {numbers[-1]})")
    index = numbers.index(number)
    found, image = labels(opened_clip, index), opened_clip.reference(index)
    if image is None:
        raise ClipError(f"{clip} has no references to lay labels over; render it again with --samples above 0")
    show(image, found, out)
    print(f"{out}: frame {number} of {clip}, ghosting on the left, aliasing on the right")
