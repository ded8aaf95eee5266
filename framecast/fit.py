"""Which methods can run on which clip, and what to do where one cannot."""

from collections.abc import Sequence
from typing import Any

from framecast.clip import Clip, ClipError
from framecast.methods import METHODS
from framecast.runtime import Mode

Method = Any
"""A module with the attributes that `methods` lists, which a type checker cannot express."""

PASSES = {
    "color": "Combined",
    "depth": "Depth",
    "motion": "Vector",
    "motion_next": "Vector",
    "albedo": "Diffuse Color",
    "normal": "Normal",
    "object": "Object Index",
}
"""Render passes that become a field, by their names in Blender; other fields have no pass there."""


def method_named(name: str) -> Method:
    """A new instance of a method, or one sentence that lists what there is."""
    if name not in METHODS:
        raise ValueError(f"there is no method {name!r}; use one of {', '.join(METHODS)}")
    return METHODS[name]()


def supports(method: Method, mode: Mode) -> bool:
    """Whether a method can run in a mode; mixed needs both of the others."""
    return all(one in method.modes for one in (("interpolate", "extrapolate") if mode == "mixed" else (mode,)))


def require_mode(name: str, method: Method, mode: Mode) -> None:
    """Raises ValueError where the method called `name` cannot run in a mode."""
    if not supports(method, mode):
        able = [other for other, make in METHODS.items() if supports(make(), mode)]
        raise ValueError(
            f"{name} cannot run with --mode {mode} (it can {' and '.join(method.modes)}); use another mode, or one of "
            f"{', '.join(able)}"
        )


def lacking(clip: Clip, method: Method) -> tuple[str, ...]:
    """Fields that a method needs and not every frame of the clip can give."""
    cameras = [f for f in ("view", "projection") if all(getattr(record, f) is not None for record in clip.shown)]
    present = (*clip.layers, *cameras)
    return tuple(field for field in dict.fromkeys((*method.needs, *method.needs_generated)) if field not in present)


def fitting(clips: Sequence[Clip], mode: Mode) -> tuple[str, ...]:
    """Names of the methods that can run on all of the clips in a mode."""
    made = {name: make() for name, make in METHODS.items()}
    return tuple(n for n, m in made.items() if supports(m, mode) and not any(lacking(clip, m) for clip in clips))


def require(clip: Clip, name: str, method: Method) -> None:
    """Raises ClipError where the clip lacks a field that the method called `name` needs, and says what to do."""
    missing = lacking(clip, method)
    if not missing:
        return
    passes = list(dict.fromkeys(PASSES[field] for field in missing if field in PASSES))
    able = {other: method_named(other) for other in METHODS}
    able = {other: made for other, made in able.items() if not lacking(clip, made)}
    advice = [f"export the {' and '.join(passes)} pass{'es' if len(passes) > 1 else ''}"] if passes else []
    if able:
        advice.append(f"use --method {max(able, key=lambda other: len(able[other].needs))}")
    todo = ", or ".join(advice) or "render the frames again with it"
    raise ClipError(
        f"{clip.path} has no {' and no '.join(missing)} (it has {', '.join(clip.layers)}); {name} needs "
        f"{'it' if len(missing) == 1 else 'them'}. {todo[0].upper()}{todo[1:]}"
    )
