"""Where in a frame methods are compared: everywhere, and the places where they fail in different ways.

Masks are `1 1 h w` at the size of the frames, from the frame's own depth and true motion. `docs/evaluation.md` says
what each is for.
"""

from collections.abc import Sequence

import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float
from torch import Tensor

from framecast.clip import Clip
from framecast.exr import read as read_exr
from framecast.frame import Frame, inverse_depth
from framecast.warp import disoccluded, trajectory

Mask = Bool[Tensor, "1 1 h w"]

SHADING = 0.05
"""Relative change of light above which a pixel counts as moving shading."""

BORDER = 16
"""Part of the height that lies beside the edge of the image: 1/16."""

STILL = 0.05
"""Motion in pixels up to which a pixel counts as static."""

THIN = 0.1
"""Part by which something thin is nearer than what lies behind it on both sides."""


def regions(clip: Clip, index: int, frame: Frame, others: Sequence[Frame]) -> dict[str, Mask | None]:
    """The regions of frame `index` that the clip's layers tell, None for all pixels.

    Args:
        others: the shaded frames that could show what the frame shows.
    """
    found: dict[str, Mask | None] = {"all": None}
    if (shading := moving_shading(clip, index)) is not None:
        found["shading"] = shading
    if frame.depth is None or frame.motion is None:
        return found
    masks = {
        "disoccluded": hidden(frame, others),
        "thin": thin(frame.depth),
        "border": border(frame.depth),
        "static": static(frame.motion) & ~(torch.zeros_like(frame.depth).bool() if shading is None else shading),
    }
    return found | masks


def hidden(frame: Frame, others: Sequence[Frame]) -> Mask:
    """Surfaces that at least one of the other frames does not show, from the true motion of the frame.

    Towards a later frame the straight continuation, where the clip has no `motion_next`.
    """
    assert frame.depth is not None
    assert frame.motion is not None
    path = trajectory(frame.motion, frame.motion_next, frame.span)
    mask = torch.zeros_like(frame.depth, dtype=torch.bool)
    for other in others:
        if other.depth is not None:
            mask |= disoccluded(frame.depth, other.depth, path.displacement(other.time - frame.time))
    return mask


def moving_shading(clip: Clip, index: int) -> Mask | None:
    """Pixels whose light changed since the frame before by more than SHADING; None where the clip has no masks."""
    path = clip.path / "masks" / f"{clip.shown[index].number:04d}.exr"
    if not path.is_file():
        return None
    change = torch.from_numpy(read_exr(path).channels["shading.Y"].astype("float32"))[None, None]
    return F.interpolate(change, clip.size, mode="area") > SHADING


def thin(depth: Float[Tensor, "1 1 h w"]) -> Mask:
    """Things up to two pixels wide that stand before something else: what a 3 x 3 opening of nearness removes.

    Pixels at the edge of the image never count: what lies beyond them is not known.
    """
    near = inverse_depth(depth)
    opened = F.max_pool2d(-F.max_pool2d(-near, 3, 1, 1), 3, 1, 1)
    found = near > opened * (1 + THIN) + 1e-6
    return F.pad(found[..., 1:-1, 1:-1], (1, 1, 1, 1))


def border(depth: Float[Tensor, "1 1 h w"]) -> Mask:
    """A frame along the edges of the image, a sixteenth of its height wide."""
    height, width = depth.shape[-2:]
    wide = max(1, height // BORDER)
    mask = torch.ones_like(depth, dtype=torch.bool)
    mask[..., wide : height - wide, wide : width - wide] = False
    return mask


def static(motion: Float[Tensor, "1 2 h w"]) -> Mask:
    """Pixels that do not move on the screen."""
    return motion.square().sum(1, keepdim=True) <= STILL**2
