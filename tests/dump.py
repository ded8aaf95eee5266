"""The wall of `wall.py` in files as any source writes them, and clips that must be the wall again."""

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
from wall import FOV, FRAMES, record, wall

from framecast import exr
from framecast.clip import Clip
from framecast.frame import camera_motion
from framecast.importers import images
from framecast.importers.encode import encode, files
from framecast.importers.settings import (
    Cameras,
    Color,
    Depth,
    Jitter,
    Motion,
    Settings,
    write_settings,
)

RGB = ("R", "G", "B")


def lay(
    folder: Path, made: Settings, frames: int = FRAMES, attributes: Callable[[int], dict[str, str]] | None = None
) -> Path:
    """The wall in a folder as settings say."""
    for time in range(frames):
        here = record(time)
        stored = encode(wall(time), made, here, record(max(time - 1, 0)), record(time + 1))
        for name, channels in files(stored, made, here.number).items():
            if attributes and name.endswith(".exr"):
                exr.write(folder / name, channels, attributes=attributes(time))
            else:
                images.write(folder / name, channels)
    return folder


def same(clip: Clip, names: tuple[str, ...], **tolerance: float) -> None:
    """The frames of a clip are the wall's; vectors of the first one lead nowhere."""
    assert set(names) <= set(clip.layers)
    for index in range(len(clip)):
        frame, wanted = clip[index], wall(index)
        for name in names:
            found = getattr(frame, name)[0].double().numpy()
            near = tolerance.get(name, 1e-3)
            np.testing.assert_allclose(
                found, wanted[name].astype(float), rtol=near, atol=near, err_msg=f"{name} {index}"
            )


def moves_as_its_cameras(clip: Clip) -> None:
    """Depth and cameras of neighbours give the wall's vectors: position, rotation, lens and handedness are right."""
    found = camera_motion(clip[2], clip[1])[0].numpy()
    np.testing.assert_allclose(found, wall(2)["motion"], atol=5e-3)
    assert clip[2].normal is None or camera_facing(clip) > 0.5


def camera_facing(clip: Clip) -> float:
    from framecast.frame import facing

    return float(facing(clip[2]).min())


def generic() -> Settings:
    return Settings(
        fps=50.0,
        color=Color(files=("beauty/*.{frame}.exr",), channels=RGB),
        depth=Depth(files=("depth/{frame}.exr",), channels=("depth.v",), kind="inverse"),
        motion=Motion(files=("mv/{frame}.exr",), channels=("R", "G"), units="ndc", sign=(1.0, -1.0)),
        jitter=Jitter(halton=4, sign=(-1.0, -1.0)),
        cameras=Cameras(fov=math.degrees(FOV)),
        notes=("found by hand",),
    )


def lay_generic(folder: Path, made: Settings | None = None) -> Path:
    made = made or generic()
    assert made.color is not None
    lay(folder, replace(made, color=replace(made.color, files=("beauty/take1.{frame}.exr",))))
    write_settings(made, folder)
    return folder
