"""Layouts that hold earlier frames warped to each frame: ExtraNet's and STSSNet's compressed arrays.

Triplets are B, G, R. History is 1, 3 and 5 frames back; frames with less of it are left out. Holes are -1.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from framecast.clip import Clip, Record
from framecast.color import demodulate, encode_srgb
from framecast.export_clip.layouts import fields_of
from framecast.exr import ClipError
from framecast.frame import Frame
from framecast.importers import images
from framecast.importers import stssnet as files
from framecast.importers.encode import encode
from framecast.methods.reproject import geometry, occluder_motion, surface, valid
from framecast.warp import chain, warp

Progress = Callable[[Sequence[int]], Iterable[int]]
Image = Float[np.ndarray, "3 h w"]

BACK = (1, 3, 5)
"""How many frames back each of the three warped images lies."""


def extranet(clip: Clip, out: Path, progress: Progress) -> str:
    """`compressed.0005.npz`: warps with holes, occluder warp, warps, target, metallic, roughness, depth, normal.

    30 channels; colour is divided by the surface colour.
    """
    count = 0
    for number, _, frames in _histories(clip, progress):
        holes, occluder, whole = warps(frames, _light)
        materials = _stored(frames[0], ("metallic", "roughness", "depth", "normal"))
        planes = [*holes, occluder, *whole, _light(frames[0])[0].numpy(), *materials]
        _write(out / f"compressed.{number:04d}.npz", planes)
        count += 1
    return _said(clip, count)


def stssnet(clip: Clip, out: Path, progress: Progress) -> str:
    """`compressed.0005.{Warp,NoWarp}.npy`, 33 channels, and `HR/compressedHR.0005.npy`, twice the size.

    As ExtraNet's, with base colour in place of the target and vectors at the end. Colour is 0..1 as displayed, not
    divided by anything. In `NoWarp`, which stands for frames that are shaded, the frame itself is its newest warp.
    """
    count = 0
    for number, index, frames in _histories(clip, progress):
        holes, occluder, whole = warps(frames, _displayed)
        own = _displayed(frames[0])[0].numpy()
        buffers = _stored(frames[0], ("albedo", "metallic", "roughness", "depth", "normal", "motion"))
        buffers[-1] = np.concatenate((buffers[-1], np.zeros_like(buffers[-1][:1])))
        _write(out / f"compressed.{number:04d}.Warp.npy", [*holes, occluder, *whole, *buffers])
        shaded = [own, *holes[1:], own, own, *whole[1:], *buffers]
        _write(out / f"compressed.{number:04d}.NoWarp.npy", shaded)
        reference = clip.reference(index)
        assert reference is not None
        _write(out / files.COLOR.replace("{frame}", f"{number:04d}"), [encode_srgb(reference.clamp(0, 1))[0].numpy()])
        count += 1
    return f"{_said(clip, count)}; colour is sRGB clipped at 1"


def _histories(clip: Clip, progress: Progress) -> Iterator[tuple[int, int, list[Frame]]]:
    """Number, index and frames, newest first, of every frame whose history is not cut.

    Raises:
        ClipError: none has any.
    """
    reach = max(BACK)
    found = False
    for index in progress(range(len(clip))):
        if index < reach or any(clip.is_cut(i) for i in range(index - reach + 1, index + 1)):
            continue
        found = True
        yield clip.shown[index].number, index, [clip[index - back] for back in range(reach + 1)]
    if not found:
        raise ClipError(f"{clip.path} has {len(clip)} frames; this layout needs {reach + 1} in a row without a cut")


def _said(clip: Clip, count: int) -> str:
    return f"{count} of them have the history of {max(BACK)} frames that it needs, and were written"


def warps(frames: Sequence[Frame], look: Callable[[Frame], Tensor]) -> tuple[list[Image], Image, list[Image]]:
    """Earlier frames as seen from `frames[0]`: with holes, the newest with holes filled beside the occluder, without.

    Args:
        frames: newest first. look: what is warped of a frame, `1 3 h w`.
    """
    here, now = frames[0], geometry(frames[0])
    depths = [frame.depth for frame in frames if frame.depth is not None]
    motions = [frame.motion for frame in frames if frame.motion is not None]
    assert here.depth is not None
    holes, whole, occluder = [], [], None
    for back in BACK:
        past = frames[back]
        shift = (here.jitter - past.jitter)[:, :, None, None]
        motion = chain(motions[:back], depths[:back]) + shift
        seen, image = valid(now, geometry(past), motion), warp(look(past), motion)
        holes.append(torch.where(seen, image, -1)[0].numpy())
        whole.append(image[0].numpy())
        if occluder is None:
            occluder = torch.where(seen, image, warp(look(past), occluder_motion(here.depth, motion)))[0].numpy()
    assert occluder is not None
    return holes, occluder, whole


def _light(frame: Frame) -> Float[Tensor, "1 3 h w"]:
    assert frame.color is not None
    return demodulate(frame.color, surface(frame))


def _displayed(frame: Frame) -> Float[Tensor, "1 3 h w"]:
    assert frame.color is not None
    return encode_srgb(frame.color.clamp(0, 1))


def _stored(frame: Frame, names: Sequence[str]) -> list[np.ndarray]:
    """Buffers in the units of both layouts, which share an exporter."""
    fields = fields_of(frame)
    stored = encode({name: fields[name] for name in names}, files.settings_of(33), Record(number=0, time=0.0))
    return [stored[name] for name in names]


def _write(path: Path, planes: Sequence[np.ndarray]) -> None:
    """Buffers one after the other, triplets turned to B, G, R."""
    flat = [plane for buffer in planes for plane in (buffer[::-1] if len(buffer) == 3 else buffer)]
    limited = (np.clip(plane, -65504, 65504) for plane in flat)
    images.write(path, {str(place): plane for place, plane in enumerate(limited)})
