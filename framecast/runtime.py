"""The streaming loop: frames in arrival order go in, images in display order come out.

A method knows only `image, state = method(frame, state)`. This file owns what lies around that call: which moments are
generated and when they are asked for (`schedule`), the order in which images are shown, how long a viewer waits
(`latency`), the device, compilation and timing (`stream`). Nothing is kept of a frame once its images are out.
"""

import copy
import os
import shutil
import time as clock
import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal, get_args

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.utils._pytree import tree_map_only

from framecast.frame import Frame, moment
from framecast.nets import has_fast_bfloat16

Mode = Literal["interpolate", "extrapolate", "mixed", "pass"]
MODES: tuple[Mode, ...] = get_args(Mode)


@dataclass(frozen=True)
class Output:
    """One image, in display order."""

    time: float
    """Moment that the image shows, in clip frames."""
    image: Float[Tensor, "b 3 H W"]
    """Linear colour, at least 0."""
    generated: bool
    """False where the renderer shaded this frame."""
    milliseconds: float
    """Time that the method took, the device waited for."""


def extrapolated(rate: int, mode: Mode, gap: int) -> int:
    """How many of the `rate - 1` images of a gap between two shaded frames are extrapolated, the earliest ones.

    Mixed follows the advice of Mob-FGSR (section 6) for two generated images, the first extrapolated for low latency,
    the second interpolated; the odd one of an uneven number takes turns, so that one generated image alternates.
    """
    if mode == "mixed":
        return (rate - 1) // 2 + ((rate - 1) % 2) * ((gap + 1) % 2)
    return rate - 1 if mode == "extrapolate" else 0


def latency(rate: int, mode: Mode) -> float:
    """How long an image waits because of the mode alone, in intervals between shaded frames.

    An interpolated image can only be made when the shaded frame after it is there; the first one of a gap waits
    longest. 0 for extrapolation and pass-through.
    """
    if mode == "pass":
        return 0.0
    first = min(extrapolated(rate, mode, gap) for gap in (0, 1))
    return 1 - (first + 1) / rate if first < rate - 1 else 0.0


def schedule(
    frames: Iterable[Frame], rate: int, mode: Mode, generated: Callable[[float], Frame] = moment, *, first: int = 0
) -> Iterator[list[Frame]]:
    """Groups of frames in arrival order: the shaded ones, and between them requests that raise the rate `rate` times.

    Extrapolated moments arrive before the shaded frame that follows them, interpolated ones after it. No image is
    interpolated across a cut: a gap that ends at one is extrapolated from the shot before. First and last frame are
    kept, so n shaded frames give rate (n - 1) + 1 images. A group is complete: sorted by time, its images may be shown.

    Args:
        generated: makes the frame to generate at a time; by default an empty request, for methods that use G-buffers
            the frame that carries them.

    Raises:
        ValueError: unknown mode, or a rate below 1.
    """
    if mode not in MODES:
        raise ValueError(f"mode is {mode!r}; use one of {', '.join(MODES)}")
    if rate < 1:
        raise ValueError(f"rate is {rate}; it has to be a whole number, at least 1")
    previous: Frame | None = None
    for gap, frame in enumerate(frames, start=first - 1):
        between = [] if previous is None or mode == "pass" else _moments(previous, frame, rate)
        count = len(between) if bool(frame.reset.all()) else extrapolated(rate, mode, gap)
        if between[:count]:
            yield [generated(t) for t in between[:count]]
        yield [frame, *(generated(t) for t in between[count:])]
        previous = frame


def _moments(previous: Frame, frame: Frame, rate: int) -> list[float]:
    start, end = float(previous.time[0]), float(frame.time[0])
    return [start + (end - start) * k / rate for k in range(1, rate)]


def stream(
    method: nn.Module,
    groups: Iterable[Sequence[Frame]],
    *,
    device: torch.device | str = "cpu",
    compile: bool = False,
    watch: Callable[[Any], None] = lambda state: None,
) -> Iterator[Output]:
    """Images in display order from groups of frames in arrival order (`schedule`, or an engine's own).

    The method's state starts at the first frame and again wherever `reset` is set; where that is a frame that was not
    shaded, at every further one until the next shaded frame, which is the first that tells of the new shot.
    Compilation happens once per size and per role (shaded, interpolated, extrapolated), on their first frames.

    Args:
        watch: gets the state after every frame, before its group's images come out.

    Raises:
        ValueError: the first frame was not shaded.
    """
    method = placed(method, device)
    call = compiled(method) if compile else method
    start: Callable[[Frame], Any] = call.start  # type: ignore[assignment]
    state: Any = None
    unlit: Tensor | None = None  # of each image of the batch whether its shot has not shown a shaded frame yet
    for group in groups:
        outputs = []
        for frame in group:
            if state is None and not frame.is_shaded:
                raise ValueError(
                    f"the first frame, at time {float(frame.time[0]):g}, was not shaded, and there is no image before "
                    f"it to go by; begin with a shaded frame"
                )
            frame = frame.to(device)
            reset = frame.reset if unlit is None else frame.reset | unlit
            frame = replace(frame, reset=reset)
            unlit = None if frame.is_shaded else reset
            started = clock.perf_counter()
            with inference(method, device):
                image, state = call(frame, start(frame) if state is None else state)
            if image.device.type == "cuda":
                torch.cuda.synchronize(image.device)
            elapsed = (clock.perf_counter() - started) * 1e3
            watch(state)
            outputs.append(Output(float(frame.time[0]), image, not frame.is_shaded, elapsed))
        yield from sorted(outputs, key=lambda output: output.time)


def require_device(device: torch.device | str) -> None:
    """Raises ValueError where this machine, or this build of PyTorch, has no such device."""
    try:
        torch.ones(1, device=device).item()
    except (RuntimeError, AssertionError, ImportError) as error:
        reason = str(error).splitlines()[0].partition(". ")[0].rstrip(".")
        raise ValueError(f"device {str(device)!r} cannot be used here ({reason}); use --device cpu") from error


def placed(method: nn.Module, device: torch.device | str) -> nn.Module:
    """The method on a device, ready for use, its weights in the order that its networks are fastest with.

    Raises:
        ValueError: there is no such device.
    """
    require_device(device)
    method = method.to(device).eval()
    if _rounds(method, device):
        method.to(memory_format=torch.channels_last)  # type: ignore[call-overload]  # torch does not declare it
    return method


@contextmanager
def inference(method: nn.Module, device: torch.device | str) -> Iterator[None]:
    """No gradients; networks in bfloat16 where the device is faster with it, everything else in float32."""
    kind = torch.device(device).type
    with torch.no_grad(), torch.autocast(kind, torch.bfloat16, enabled=_rounds(method, device)):
        yield


def _rounds(method: nn.Module, device: torch.device | str) -> bool:
    return any(True for _ in method.parameters()) and has_fast_bfloat16(device)


OPTIONS: dict[str, Any] = {"assert_indirect_indexing": False}
"""For `torch.compile`: no checks of indices inside of the loops, where they cost a third of the time; `warp.py` keeps
every index inside of the image whatever the motion, and the tests check them."""


def compiled(method: nn.Module) -> nn.Module:
    """The method with its `parts` compiled for fixed sizes; eager, with one warning, where there is no C++ compiler.

    `parts` names the methods of the module that hold its arithmetic, so that the choice between them (shaded,
    interpolated, extrapolated) stays outside of the graphs; without it the whole call is compiled. `inner` names those
    of its submodules that are methods themselves. Compiled code is kept in the user's cache folder between runs, so
    that only the first run of a size pays in full.
    """
    if not can_compile():
        warnings.warn("no C++ compiler found (install g++ or clang++): running without torch.compile", stacklevel=2)
        return method
    cache = Path(os.environ.get("XDG_CACHE_HOME", Path.home() / ".cache")) / "framecast" / "compiled"
    os.environ.setdefault("TORCHINDUCTOR_CACHE_DIR", str(cache))
    fast = copy.copy(method)
    for name in getattr(method, "inner", ()):
        object.__setattr__(fast, name, compiled(getattr(method, name)))
    for name in getattr(method, "parts", ("forward",)):
        object.__setattr__(fast, name, torch.compile(getattr(method, name), dynamic=False, options=OPTIONS))
    object.__setattr__(fast, "start", lambda frame: _apart(method.start(frame)))  # type: ignore[operator]
    return fast


def _apart(state: Any) -> Any:
    """The state with tensors of its own: those of a first state are the frame's, and compiled code that has met one
    tensor in two places is compiled again when they differ."""
    return tree_map_only(Tensor, torch.clone, state)


def can_compile() -> bool:
    """Whether a C++ compiler is there, which `torch.compile` needs at run time on the CPU."""
    return any(shutil.which(name) for name in (os.environ.get("CXX", "g++"), "g++", "clang++", "cl"))
