"""The streaming loop: arrival order in, display order out, nothing lost, nothing kept."""

import gc
import warnings
from collections.abc import Iterator
from dataclasses import dataclass, replace

import pytest
import torch
from conftest import disc_frame
from passing import shot
from torch import nn

from framecast import runtime
from framecast.frame import Frame, moment, unshaded
from framecast.methods import METHODS
from framecast.runtime import MODES, compiled, latency, schedule, stream


@dataclass(frozen=True)
class Seen:
    """Times of the shaded frames that arrived since the last reset."""

    times: tuple[float, ...]


class Recorder(nn.Module):
    """Answers with an image that holds the frame's time, and writes down what it was asked."""

    def __init__(self) -> None:
        super().__init__()
        self.calls: list[tuple[float, str, tuple[float, ...]]] = []

    def start(self, frame: Frame) -> Seen:
        return Seen(())

    def forward(self, frame: Frame, state: Seen) -> tuple[torch.Tensor, Seen]:
        time = float(frame.time)
        if frame.is_shaded:
            state = Seen((time,) if bool(frame.reset) else (*state.times[-1:], time))
        role = "shaded" if frame.is_shaded else "beyond" if time > state.times[-1] else "between"
        self.calls.append((time, role, state.times))
        return torch.full((1, 3, 2, 2), time), state


def frames(count: int, cut: int | None = None) -> Iterator[Frame]:
    for t in range(count):
        yield replace(disc_frame(t, height=4, width=6), reset=torch.tensor([t in (0, cut)]))


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("rate", [1, 2, 3, 4])
def test_images_come_in_display_order_and_none_is_lost(mode: runtime.Mode, rate: int) -> None:
    method = Recorder()
    outputs = list(stream(method, schedule(frames(4), rate, mode)))
    step = 1 if mode == "pass" else 1 / rate
    expected = torch.arange(0, 3 + step / 2, step)
    torch.testing.assert_close(torch.tensor([o.time for o in outputs]), expected)
    for output in outputs:
        assert (output.image == output.time).all()
        assert output.generated == (output.time % 1 != 0)


def test_interpolation_waits_for_the_next_frame_and_extrapolation_does_not() -> None:
    roles = {}
    for mode in ("interpolate", "extrapolate"):
        method = Recorder()
        list(stream(method, schedule(frames(3), 2, mode)))
        roles[mode] = [(time, role) for time, role, _ in method.calls]
    assert roles["interpolate"] == [(0, "shaded"), (1, "shaded"), (0.5, "between"), (2, "shaded"), (1.5, "between")]
    assert roles["extrapolate"] == [(0, "shaded"), (0.5, "beyond"), (1, "shaded"), (1.5, "beyond"), (2, "shaded")]


def test_mixed_extrapolates_the_first_and_interpolates_the_second() -> None:
    method = Recorder()
    list(stream(method, schedule(frames(2), 3, "mixed")))
    assert [role for _, role, _ in method.calls] == ["shaded", "beyond", "shaded", "between"]


def test_mixed_with_one_generated_frame_takes_turns_wherever_the_run_starts() -> None:
    def run(start: int) -> list[tuple[float, str]]:
        method = Recorder()
        shots = [f for f in frames(6) if float(f.time) >= start]
        list(stream(method, schedule(shots, 2, "mixed", first=start)))
        return [(t, r) for t, r, _ in method.calls if r != "shaded"]

    assert [r for _, r in run(0)] == ["beyond", "between", "beyond", "between", "beyond"]
    assert run(0)[-2:] == run(3)


def test_nothing_is_interpolated_across_a_cut() -> None:
    method = Recorder()
    list(stream(method, schedule(frames(4, cut=2), 2, "interpolate")))
    at_cut = [call for call in method.calls if call[0] == 1.5]
    assert at_cut == [(1.5, "beyond", (0, 1))]
    assert [call for call in method.calls if call[0] == 2.5] == [(2.5, "between", (2, 3))]


def test_latency_is_what_the_first_interpolated_image_waits() -> None:
    assert [latency(2, m) for m in MODES] == [0.5, 0, 0.5, 0]
    assert latency(3, "interpolate") == pytest.approx(2 / 3)
    assert latency(3, "mixed") == pytest.approx(1 / 3)
    assert latency(1, "interpolate") == 0


def test_unknown_modes_and_rates_are_refused() -> None:
    with pytest.raises(ValueError, match="rate is 0"):
        list(schedule(frames(2), 0, "interpolate"))
    with pytest.raises(Exception, match="mode"):
        list(schedule(frames(2), 2, "backwards"))


def test_generated_frames_may_carry_buffers() -> None:
    def with_depth(time: float) -> Frame:
        return replace(moment(time), depth=torch.ones(1, 1, 4, 6))

    groups = list(schedule(frames(2), 2, "extrapolate", with_depth))
    assert [f.depth is not None for f in groups[1]] == [True]
    assert not groups[1][0].is_shaded


@pytest.mark.parametrize("name", ["mobfgsr", "bsr"])
def test_no_frame_outlives_its_images(name: str) -> None:
    """After many frames as many are alive as after few."""

    def alive() -> int:
        gc.collect()
        return sum(type(o) is Frame for o in gc.get_objects())

    before = alive()
    counts = []
    for i, _ in enumerate(stream(METHODS[name](), schedule(frames(30), 2, "interpolate"))):
        if i in (9, 49):
            counts.append(alive() - before)
    assert counts[0] == counts[1]
    assert counts[1] <= 6


def test_streaming_equals_calling_the_method() -> None:
    method = METHODS["mobfgsr"]()
    a, b = list(frames(2))
    state = method.start(a)
    _, state = method(a, state)
    _, state = method(b, state)
    expected, _ = method(moment(0.5), state)
    out = list(stream(method, schedule(iter([a, b]), 2, "interpolate")))
    assert torch.equal(out[1].image, expected)


def test_a_run_begins_with_a_shaded_frame_or_says_so() -> None:
    with pytest.raises(ValueError, match=r"first frame, at time 0, was not shaded.* begin with a shaded frame"):
        list(stream(METHODS["warp"](), [[unshaded(shot(0.0))], [shot(1.0)]]))


@pytest.mark.parametrize("name", ["warp", "extrass-warp"])
def test_a_shot_that_begins_with_two_unshaded_frames_is_a_new_shot_in_both_and_in_the_shaded_one(name: str) -> None:
    """None of them shows, or later remembers, what lay where its vectors lead in the shot before."""
    cut = torch.tensor([True])
    wild = torch.full_like(shot(1.0).motion, 7.0)  # type: ignore[arg-type]
    first, two = replace(unshaded(shot(1.0)), reset=cut, motion=wild), replace(unshaded(shot(2.0)), motion=wild)
    lit, last = replace(shot(3.0), motion=wild), unshaded(shot(4.0, span=1.0))
    seen: list[tuple[bool, bool]] = []
    method = METHODS[name]()
    call = method.forward
    method.forward = lambda frame, state: (seen.append((frame.is_shaded, bool(frame.reset))), call(frame, state))[1]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        images = [output.image for output in stream(method, [[shot(0.0)], [first], [two], [lit], [last]])]
    assert seen == [(True, True), (False, True), (False, True), (True, True), (False, False)]
    fresh = [output.image for output in stream(METHODS[name](), [[replace(lit, reset=cut)], [last]])]
    torch.testing.assert_close(images[3:], fresh)


def test_without_a_compiler_it_stays_eager_and_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(runtime, "can_compile", lambda: False)
    method = METHODS["hold"]()
    with pytest.warns(UserWarning, match="no C\\+\\+ compiler"):
        assert compiled(method) is method
    monkeypatch.setattr(runtime, "can_compile", lambda: True)
    assert compiled(method) is not method
