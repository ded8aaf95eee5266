"""How fast one frame is interpolated, against what else one could do: docs/results/interpolation-speed.md.

    python benchmarks/interpolation.py [--size 1280x720] [--repeats 60] [--out docs/results/interpolation-speed.md]

Needs the packages of the extra `bench`. The same two shaded frames of the moving scene of `framecast.sample` go to:
eager   `mobfgsr.interpolate`, plain PyTorch
compiled  the same function as `framecast.runtime.compiled` builds it, with its default settings and true motion
numba   the same algorithm written as fused loops below; its image is compared with the eager one
DIS     OpenCV: dense optical flow from the colours alone, both frames remapped half-way and mixed
copy    `torch.Tensor.copy_` of as many bytes as interpolation must read and write at least
All take turns within one process; a call of each is one repeat.
"""

import os
import statistics
import tempfile
import time as clock
from collections.abc import Callable
from pathlib import Path

import cv2
import numba
import numpy as np
import torch
import tyro
from numba import njit, prange

from framecast import exr
from framecast.bench import SHADED, Settings, first_calls_elsewhere, run_clip, variant
from framecast.color import to_display
from framecast.methods.mobfgsr import MobFGSR, present
from framecast.methods.pair import Pair
from framecast.provenance import machine
from framecast.sample import GAP, scene

EMPTY = 0x7F800000 << 32
f32 = np.float32


@njit(parallel=True)
def numba_land(motion, ahead, span, dt, cell):
    """Where each pixel lands on a grid with a border of one; one cell past its end where off the image."""
    _, height, width = motion.shape
    v, a = dt / (f32(2) * span), f32(0.5) * dt * dt / (span * span)
    for j in prange(height):
        for i in range(width):
            x = f32(i) + (ahead[0, j, i] - motion[0, j, i]) * v + (ahead[0, j, i] + motion[0, j, i]) * a
            y = f32(j) + (ahead[1, j, i] - motion[1, j, i]) * v + (ahead[1, j, i] + motion[1, j, i]) * a
            column, row = int(np.floor(x + f32(0.5))), int(np.floor(y + f32(0.5)))
            inside = 0 <= column < width and 0 <= row < height
            cell[j, i] = (row + 1) * (width + 2) + column + 1 if inside else (height + 2) * (width + 2)


@njit
def numba_scatter(bits, cell, keys):
    """The nearest of the pixels that land in each cell, one after another: threads would race."""
    keys[:] = EMPTY
    for source in range(cell.size):
        key = (np.int64(bits[source]) << 32) | source
        if key < keys[cell[source]]:
            keys[cell[source]] = key


@njit(inline="always")
def numba_refined(keys, depths, centre, wide):
    """Key and depth of a pixel after gaps are closed; `keys` and `depths` (the same memory) are flat, with a border."""
    limit = depths[2 * centre + 1] * f32(0.98)
    n, s = depths[2 * (centre - wide) + 1] >= limit, depths[2 * (centre + wide) + 1] >= limit
    w, e = depths[2 * centre - 1] >= limit, depths[2 * centre + 3] >= limit
    nw, ne = depths[2 * (centre - wide) - 1] >= limit, depths[2 * (centre - wide) + 3] >= limit
    sw, se = depths[2 * (centre + wide) - 1] >= limit, depths[2 * (centre + wide) + 3] >= limit
    if (n and w and nw) or (n and e and ne) or (s and w and sw) or (s and e and se):
        return keys[centre], depths[2 * centre + 1]
    best, at = keys[centre], centre
    for dy in (-wide, 0, wide):
        for dx in (-1, 0, 1):
            if keys[centre + dy + dx] < best:
                best, at = keys[centre + dy + dx], centre + dy + dx
    return best, depths[2 * at + 1]


@njit(inline="always")
def numba_sample(image, x, y, out):
    """Bilinear, edge pixels repeated."""
    _, height, width = image.shape
    x, y = min(max(x, f32(0)), f32(width - 1)), min(max(y, f32(0)), f32(height - 1))
    left, top = int(x), int(y)
    fx, fy = x - f32(left), y - f32(top)
    right, low = min(left + 1, width - 1), min(top + 1, height - 1)
    for c in range(3):
        a, b = image[c, top, left], image[c, top, right]
        d, e = image[c, low, left], image[c, low, right]
        a, d = a + fx * (b - a), d + fx * (e - d)
        out[c] = a + fy * (d - a)


@njit(inline="always")
def numba_nearest(depth, x, y):
    """The pixel that contains a position, and whether that is on the image."""
    height, width = depth.shape
    column = min(max(int(np.floor(x + f32(0.5))), 0), width - 1)
    row = min(max(int(np.floor(y + f32(0.5))), 0), height - 1)
    seen = f32(-0.5) <= x <= f32(width - 0.5) and f32(-0.5) <= y <= f32(height - 0.5)
    return depth[row, column], seen


@njit(inline="always")
def numba_arrival(keys, depths, centre, wide, motion, ahead, span, dt, gap):
    """Depth of what a frame sends to a pixel (infinite: nothing), and from where: own x, y, the other frame's x, y."""
    key, depth = numba_refined(keys, depths, centre, wide)
    if key == EMPTY:
        return f32(np.inf), f32(0), f32(0), f32(0), f32(0)
    width = wide - 2
    row, column = (key & 0xFFFFFFFF) // width, (key & 0xFFFFFFFF) % width
    v, a = dt / (f32(2) * span), f32(0.5) * dt * dt / (span * span)
    vg, ag = gap / (f32(2) * span), f32(0.5) * gap * gap / (span * span)
    mx, my, nx, ny = motion[0, row, column], motion[1, row, column], ahead[0, row, column], ahead[1, row, column]
    x, y = -((nx - mx) * v + (nx + mx) * a), -((ny - my) * v + (ny + my) * a)
    return depth, x, y, x + (nx - mx) * vg + (nx + mx) * ag, y + (ny - my) * vg + (ny + my) * ag


@njit(parallel=True)
def numba_gather(old, new, dt, gap, out):
    """Gaps closed, what both frames send compared, both sampled and mixed, one pixel after another.

    old, new: (keys, the same as floats, motion, motion_next, span, colour, depth); dt from the new frame, negative.
    """
    keys0, floats0, motion0, ahead0, span0, color0, depth0 = old
    keys1, floats1, motion1, ahead1, span1, color1, depth1 = new
    _, height, width = out.shape
    alpha, wide = (gap + dt) / gap, width + 2
    for j in prange(height):
        before, after = np.empty(3, f32), np.empty(3, f32)
        for i in range(width):
            centre = (j + 1) * wide + i + 1
            late, x1, y1, u0, v0 = numba_arrival(keys1, floats1, centre, wide, motion1, ahead1, span1, dt, -gap)
            early, x0, y0, u1, v1 = numba_arrival(keys0, floats0, centre, wide, motion0, ahead0, span0, gap + dt, gap)
            same = abs(early / late - f32(1)) < f32(0.1)
            use_late = late < np.inf and (late >= early or early == np.inf)
            if use_late and not same:
                x0, y0 = u0, v0
            elif not use_late and not same:
                x1, y1 = u1, v1
            if late == np.inf and early == np.inf:
                x, y = -motion0[0, j, i] / span0, -motion0[1, j, i] / span0
                x1, y1, x0, y0 = -x * dt, -y * dt, -x * (gap + dt), -y * (gap + dt)
            x0, y0, x1, y1 = f32(i) + x0, f32(j) + y0, f32(i) + x1, f32(j) + y1
            numba_sample(color0, x0, y0, before)
            numba_sample(color1, x1, y1, after)
            d0, seen0 = numba_nearest(depth0, x0, y0)
            d1, seen1 = numba_nearest(depth1, x1, y1)
            weight = alpha
            if seen0 and (d0 > d1 * f32(1.1) or not seen1):
                weight = f32(0)
            elif seen1 and (d1 > d0 * f32(1.1) or not seen0):
                weight = f32(1)
            for c in range(3):
                out[c, j, i] = before[c] + weight * (after[c] - before[c])


def numba_interpolation(state: Pair, time: torch.Tensor) -> Callable[[], np.ndarray]:
    """`mobfgsr.interpolate` with its default settings and true motion, as a call on arrays that are ready."""
    dt, gap = f32(time[0] - state.current.time[0]), f32(state.current.time[0] - state.prev.time[0])
    height, width = present(state.current.depth).shape[-2:]
    cell = np.empty((height, width), np.int32)
    frames = []
    for frame in (state.prev, state.current):
        motion, ahead, color = (present(b)[0].numpy() for b in (frame.motion, frame.motion_next, frame.color))
        keys = np.empty((height + 2) * (width + 2) + 1, np.int64)
        depth = present(frame.depth)[0, 0].numpy()
        frames.append((keys, keys.view(f32), motion, ahead, f32(frame.span[0]), color, depth))

    def run() -> np.ndarray:
        out = np.empty((3, height, width), f32)
        for (keys, _, motion, ahead, span, _, depth), t in zip(frames, (gap + dt, dt), strict=True):
            numba_land(motion, ahead, span, t, cell)
            numba_scatter(depth.reshape(-1).view(np.int32), cell.reshape(-1), keys)
        numba_gather(*frames, dt, gap, out)
        return out

    return run


def dis_interpolation(state: Pair, preset: int) -> Callable[[], np.ndarray]:
    """Optical flow between the displayed colours, and both frames fetched along it to the middle."""
    before, after = (np.ascontiguousarray(present(f.color)[0].permute(1, 2, 0)) for f in (state.prev, state.current))
    height, width, _ = before.shape
    grid = np.stack(np.meshgrid(np.arange(width, dtype=f32), np.arange(height, dtype=f32)), -1)
    eight = [
        (to_display(present(f.color))[0].permute(1, 2, 0) * 255).byte().numpy() for f in (state.prev, state.current)
    ]
    search = cv2.DISOpticalFlow_create(preset)

    def run() -> np.ndarray:
        gray = [cv2.cvtColor(np.ascontiguousarray(image), cv2.COLOR_RGB2GRAY) for image in eight]
        half = search.calc(gray[0], gray[1], None) * f32(0.5)
        warped = [
            cv2.remap(image, grid + sign * half, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
            for image, sign in ((before, -1), (after, 1))
        ]
        return cv2.addWeighted(warped[0], 0.5, warped[1], 0.5, 0)

    return run


def copying(height: int, width: int) -> Callable[[], torch.Tensor]:
    """Reads and writes as many planes as interpolation: 16 in (of both frames), 3 out."""
    source = torch.rand(19 * height * width // 2)
    target = torch.empty_like(source)
    return lambda: target.copy_(source)


def in_turn(calls: dict[str, Callable[[], object]], repeats: int) -> dict[str, list[float]]:
    """Milliseconds of each call, sorted, all in turn after two rounds that do not count."""
    found: dict[str, list[float]] = {name: [] for name in calls}
    for _ in range(repeats + 2):
        for name, call in calls.items():
            started = clock.perf_counter()
            call()
            found[name].append((clock.perf_counter() - started) * 1e3)
    return {name: sorted(values[2:]) for name, values in found.items()}


def check_twin(image: np.ndarray, expected: np.ndarray) -> float:
    """The part of pixels on which the twin differs: where rounding sends a pixel to its neighbour.

    Raises:
        AssertionError: more than rounding can explain.
    """
    wrong = (np.abs(image - expected).max(0) > 1e-3).mean()
    assert wrong < 1e-4, f"the Numba twin differs on {wrong:.3%} of the pixels"
    return float(wrong)


PAGE = """# Speed of interpolation

One frame between two shaded ones, {width}x{height}, {repeats} times, all in turn within one process
(`python benchmarks/interpolation.py`). {machine}.

| | median ms | quartiles | least | median / compiled |
|---|---|---|---|---|
{rows}

- eager, compiled: `mobfgsr`, colour in, colour out, motion and depth as the shaded step left them. Their images differ
  by at most {difference:.1g}.
- numba: the same algorithm as fused loops, landing and scattering for each frame, one for the rest; {twin:.4%} of its
  pixels differ (rounding at a pixel's edge).
- dis medium, dis ultrafast: OpenCV's optical flow from colour alone, both frames remapped half-way and mixed.
- copy: as many bytes as interpolation has to read and write at least: the bound that memory sets.
- Compilation of all roles (shaded step, interpolation, extrapolation): {cold:.0f} s in a new process with an empty
  cache, {warm:.0f} s in the next process. Recompilations while a clip ran: {recompilations}.
"""


def page(times: dict[str, list[float]], described: dict[str, str | int | float], **values: object) -> str:
    """The page from sorted times."""
    reference = statistics.median(times["compiled"])
    rows = []
    for name, found in times.items():
        lower, median, upper = statistics.quantiles(found, n=4, method="inclusive")
        cells = (f"{median:.1f}", f"{lower:.1f} - {upper:.1f}", f"{found[0]:.1f}", f"{median / reference:.2f}")
        rows.append(f"| {' | '.join((name, *cells))} |")
    text = ", ".join(f"{key} {value}" for key, value in described.items())
    return PAGE.format(rows="\n".join(rows), machine=text[0].upper() + text[1:], **values)


def main(
    size: str = "1280x720",
    repeats: int = 60,
    threads: int = 2,
    out: Path = Path("docs/results/interpolation-speed.md"),
) -> None:
    """Measure, print, and write the page."""
    width, height = (int(part) for part in size.split("x"))
    torch.set_num_threads(threads)
    numba.set_num_threads(threads)
    cv2.setNumThreads(threads)
    settings = Settings(height, width)
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as cache:
        cold, warm = (sum(first_calls_elsewhere("mobfgsr", settings, cache).values()) for _ in range(2))
        os.environ["TORCHINDUCTOR_CACHE_DIR"] = cache
        frames = [scene(GAP * i, height, width) for i in range(SHADED)]
        fast = run_clip(variant("mobfgsr", MobFGSR(), True, settings), frames, settings)
        eager, state, time = MobFGSR(), fast.state, frames[-1].time - GAP / 2
        with torch.no_grad():
            expected, image = eager.interpolate(state, time), fast.call.interpolate(state, time)
            torch.testing.assert_close(image, expected, atol=1e-3, rtol=0)
            twin = numba_interpolation(state, time)
            differs = check_twin(twin(), expected[0].numpy())
            calls = {
                "compiled": lambda: fast.call.interpolate(state, time),
                "eager": lambda: eager.interpolate(state, time),
                "numba": twin,
                "dis medium": dis_interpolation(state, cv2.DISOPTICAL_FLOW_PRESET_MEDIUM),
                "dis ultrafast": dis_interpolation(state, cv2.DISOPTICAL_FLOW_PRESET_ULTRAFAST),
                "copy": copying(height, width),
            }
            times = in_turn(calls, repeats)
    text = page(
        times,
        machine(),
        width=width,
        height=height,
        repeats=repeats,
        difference=float((image - expected).abs().max()),
        twin=differs,
        cold=cold,
        warm=warm,
        recompilations=fast.recompilations,
    )
    print(text)
    with exr.whole(out) as temporary:
        temporary.write_text(text)


if __name__ == "__main__":
    tyro.cli(main)
