"""Which methods can run on which clip, and what to do where one cannot."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from framecast.checkpoint import fill
from framecast.clip import Clip, ClipError
from framecast.methods import METHODS, TRAINABLE
from framecast.methods.compose import Composed, generating, scale_of
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


def method_named(name: str, scale: float | None = None) -> Method:
    """A new instance of a method for a scale (by default its own), or one sentence on what there is.

    "NAME=FILE" is the method NAME with the weights that a training run wrote, `runs/x/weights.safetensors`; "a+b" is b
    after a (`compose.py`), where the scale is that of the method that does not make frames.
    """
    if "+" in name and not Path(name.partition("=")[2]).is_file():
        first, _, second = name.rpartition("+")
        return after(first.strip(), second.strip(), scale)
    name, given, weights = name.strip().partition("=")
    if given and not weights:
        raise ValueError(f"{name}= names no file of weights; give {name}=FILE, or {name} for the weights that ship")
    names: Mapping[str, Any] = TRAINABLE if weights else METHODS
    if name not in names:
        advice = f"; {name} has no weights of its own: use {name}=FILE" if name in TRAINABLE else ""
        raise ValueError(f"there is no method {name!r}; use one of {', '.join(names)}{advice}")
    method: Method = fill(TRAINABLE[name][0](), name, Path(weights)).eval() if weights else METHODS[name]()
    if scale is None or scale == scale_of(method):
        return method
    if scale not in method.scales:
        able = [other for other, make in METHODS.items() if scale in make().scales]  # type: ignore[operator]
        sizes = ", ".join(f"{s:g}" for s in method.scales)
        advice = f", or one of {', '.join(able)}" if able else ""
        raise ValueError(
            f"{name} cannot make {scale:g} times the size (it can make {sizes}); use another scale{advice}"
        )
    other: Method = type(method)(replace(method.config, scale=scale))
    other.load_state_dict(method.state_dict())
    return other.eval()


def after(first: str, second: str, scale: float | None) -> Method:
    """The method of one name after that of another."""
    a, b = method_named(first), method_named(second)
    if scale is not None and generating(a):
        b = method_named(second, scale / scale_of(a))
    elif scale is not None:
        a = method_named(first, scale / scale_of(b))
    return Composed(a, b, f"{first}+{second}")


def supports(method: Method, mode: Mode) -> bool:
    """Whether a method can run in a mode; mixed needs interpolation and extrapolation."""
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


def fitting(clips: Sequence[Clip], mode: Mode, scales: Sequence[float | None] = ()) -> tuple[str, ...]:
    """Names of the methods that can run on all of the clips in a mode, and at each of the scales that is not None.

    Where none is given, frames are made at their own size.
    """
    made: dict[str, Method] = {name: make() for name, make in METHODS.items()}
    wanted = {scale for scale in scales if scale is not None} or ({1.0} if mode != "pass" else set())
    able = {name: m for name, m in made.items() if supports(m, mode) and wanted <= {*m.scales, scale_of(m)}}
    return tuple(name for name, m in able.items() if not any(lacking(clip, m) for clip in clips))


def alike(other: Method, method: Method) -> bool:
    """Whether another method can be had at the size of a method, for some of its modes."""
    return scale_of(method) in (scale_of(other), *other.scales) and bool({*other.modes} & {*method.modes})


def require(clip: Clip, name: str, method: Method, *, others: bool = True) -> None:
    """Raises ClipError where the clip lacks a field that the method called `name` needs, and says what to do.

    Args:
        others: also name another method that could be used.
    """
    missing = lacking(clip, method)
    if not missing:
        return
    passes = list(dict.fromkeys(PASSES[field] for field in missing if field in PASSES))
    able: dict[str, Method] = {other: make() for other, make in METHODS.items()}
    able = {other: m for other, m in able.items() if alike(m, method) and not lacking(clip, m)}
    advice = [f"export the {' and '.join(passes)} pass{'es' if len(passes) > 1 else ''}"] if passes else []
    if able and others:
        advice.append(f"use --method {max(able, key=lambda other: len(able[other].needs))}")
    todo = ", or ".join(advice) or "render the frames again with it"
    raise ClipError(
        f"{clip.path} has no {' and no '.join(missing)} (it has {', '.join(clip.layers)}); {name} needs "
        f"{'it' if len(missing) == 1 else 'them'}. {todo[0].upper()}{todo[1:]}"
    )
