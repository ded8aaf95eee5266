"""The training cache, crops that are clips, flips that know vectors, samples that depend on their number alone."""

import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from passing import shot, write_shots
from torch import Tensor

from framecast.clip import Clip, ClipError, Record, open_clip
from framecast.data import (
    MIRRORS,
    Footage,
    Samples,
    batches,
    flipped,
    flipped_image,
    footage,
    joined,
    recoloured,
    turned,
    window,
)
from framecast.frame import Frame, camera_motion, facing, perspective
from framecast.methods.extranet import ExtraNet, recipe
from framecast.methods.reproject import geometry, light, steps
from framecast.warp import warp

FIELDS = tuple(dict.fromkeys((*ExtraNet.needs, *ExtraNet.needs_generated)))
SMALL = replace(recipe, crop=(16, 16), batch=4, steps=3, recolour=False)


@pytest.fixture
def clip(tmp_path: Path) -> Clip:
    return write_shots(tmp_path / "clip", 9, square=2.0)


@pytest.fixture
def source(clip: Clip, tmp_path: Path) -> Footage:
    return footage(clip, tmp_path / "cache")


def turning() -> tuple[Frame, Frame]:
    """A frame of random surfaces and the one before, seen by a camera that turns and moves; jittered."""
    angle = torch.tensor(0.1)
    turn = torch.eye(4)
    turn[0, 0] = turn[2, 2] = angle.cos()
    turn[0, 2], turn[2, 0], turn[1, 3] = angle.sin(), -angle.sin(), 0.2
    height, width = 16, 16
    smooth = torch.nn.functional.interpolate(torch.rand(1, 1, 3, 3), (height, width), mode="bilinear")
    last = shot(3.0, jitter=(0.3, -0.2))
    crop = {n: getattr(last, n)[..., :height, :width] for n in ("color", "albedo", "roughness", "metallic", "object")}
    normal = torch.nn.functional.normalize(torch.randn(1, 3, height, width), dim=1)
    last = replace(
        last,
        **crop,
        depth=3 + smooth,
        normal=normal,
        motion=torch.zeros(1, 2, height, width),
        view=torch.eye(4)[None],
        projection=perspective(0.9, 1.0)[None],
    )
    now = replace(last, view=turn[None], jitter=torch.tensor([[-0.1, 0.4]]), time=torch.tensor([5.0]))
    return replace(now, motion=camera_motion(now, last)), last


# Flips.


@pytest.mark.parametrize("flip", MIRRORS)
def test_a_flipped_frame_warps_to_the_flipped_warp(flip: str) -> None:
    now, last = turning()
    assert now.motion is not None
    assert last.color is not None
    assert float(now.motion.abs().min(0).values.max()) > 0.5
    turned, before = flipped(now, flip), flipped(last, flip)
    assert turned.motion is not None
    assert before.color is not None
    expected = flipped_image(warp(last.color, now.motion), flip)
    torch.testing.assert_close(warp(before.color, turned.motion), expected, atol=1e-5, rtol=0)


@pytest.mark.parametrize("flip", MIRRORS)
def test_flipped_cameras_cause_the_flipped_motion(flip: str) -> None:
    now, last = turning()
    turned, before = flipped(now, flip), flipped(last, flip)
    torch.testing.assert_close(camera_motion(turned, before), turned.motion, atol=1e-4, rtol=0)
    assert turned.view is not None
    torch.testing.assert_close(torch.linalg.det(turned.view[:, :3, :3]), torch.ones(1))


@pytest.mark.parametrize("flip", MIRRORS)
def test_flipped_normals_face_the_flipped_camera_alike(flip: str) -> None:
    now, _ = turning()
    torch.testing.assert_close(facing(flipped(now, flip)), flipped_image(facing(now), flip), atol=1e-5, rtol=0)


@pytest.mark.parametrize("flip", MIRRORS)
def test_flipped_jitter_sees_the_mirrored_world(flip: str) -> None:
    """Samples off the centres lie at the mirrored places, and vectors between two jittered frames turn alike."""
    now, last = turning()
    turned, before = flipped(now, flip), flipped(last, flip)
    mirror = torch.tensor(MIRRORS[flip], dtype=torch.float32)
    expected = torch.einsum("ij,bjhw->bihw", mirror, flipped_image(geometry(now).position, flip))
    torch.testing.assert_close(geometry(turned).position, expected, atol=1e-5, rtol=1e-5)
    vectors = flipped(replace(now, motion=steps(now, last.time, last.jitter)), flip).motion
    torch.testing.assert_close(steps(turned, before.time, before.jitter), vectors)


@pytest.mark.parametrize("flip", MIRRORS)
def test_flipping_twice_is_nothing(flip: str) -> None:
    now, _ = turning()
    again = flipped(flipped(now, flip), flip)
    for name in ("color", "motion", "normal", "view", "projection", "jitter"):
        torch.testing.assert_close(getattr(again, name), getattr(now, name))


def test_flips_together_are_one_after_the_other() -> None:
    now, _ = turning()
    one_by_one = now
    for flip in ("transpose", "horizontal", "vertical"):
        one_by_one = flipped(one_by_one, flip)
    at_once = flipped(now, "transpose", "horizontal", "vertical")
    for name in ("color", "motion", "normal", "view", "projection", "jitter"):
        torch.testing.assert_close(getattr(at_once, name), getattr(one_by_one, name))


# Colours, and where the light comes from.


def test_a_turned_world_looks_the_same() -> None:
    """Positions and normals turn, and what is seen from the camera does not: motion, facing, what is valid."""
    now, last = turning()
    world = torch.linalg.qr(torch.randn(3, 3)).Q
    a, b = turned(now, world), turned(last, world)
    expected = torch.einsum("ij,bjhw->bihw", world, geometry(now).position)
    torch.testing.assert_close(geometry(a).position, expected, atol=1e-4, rtol=0)
    torch.testing.assert_close(geometry(a).facing, geometry(now).facing, atol=1e-4, rtol=0)
    torch.testing.assert_close(camera_motion(a, b), now.motion, atol=1e-3, rtol=0)
    assert not torch.allclose(a.normal, now.normal, atol=0.1)


def test_recoloured_surfaces_hold_the_recoloured_light() -> None:
    now, _ = turning()
    other = recoloured(now, (2, 0, 1))
    torch.testing.assert_close(light(other), light(now)[:, [2, 0, 1]])
    assert torch.equal(other.normal, now.normal)


def test_a_recoloured_sample_is_the_plain_one_in_other_colours(source: Footage) -> None:
    """Its truth holds the same values, but for one factor for each channel, which its frames share."""
    plain, other = samples(source, stops=0.0)[3], samples(source, stops=0.0, recolour=True)[3]
    truths = [sample.targets[0, 0].flatten(1) for sample in (plain, other)]
    order = [int((truths[0][:, :1] / truths[0] * row / row[0]).var(1).argmin()) for row in truths[1]]
    assert sorted(order) == [0, 1, 2]
    gain = truths[1] / truths[0][order]
    assert float((gain.amax(1) - gain.amin(1)).max()) < 1e-3
    assert float((gain.mean(1).log2()).abs().max()) <= 0.5
    for a, b in zip(plain.frames[:3], other.frames[:3], strict=True):
        torch.testing.assert_close(b.color[0], a.color[0, order] * gain.mean(1)[:, None, None], atol=1e-4, rtol=1e-3)
        assert torch.equal(b.motion, a.motion)


# The cache.


def test_the_cache_holds_the_clip(clip: Clip, source: Footage) -> None:
    whole = window(source, (0, 0), clip.size)
    for index in (0, 4, 8):
        frame, cached = clip[index], whole[index]
        for name in ("color", "depth", "motion", "normal", "object", "projection", "view"):
            torch.testing.assert_close(getattr(cached, name), getattr(frame, name))
    assert torch.equal(whole.every(2)[1].motion, clip.every(2)[1].motion)  # type: ignore[arg-type]


def test_the_cache_is_kept_until_the_clip_changes(clip: Clip, tmp_path: Path) -> None:
    def written() -> float:
        footage(open_clip(clip.path), tmp_path / "cache")
        return next((tmp_path / "cache").glob("*/color.npy")).stat().st_mtime_ns

    first = written()
    assert written() == first
    os.utime(clip.path / "frames" / "0003.exr", ns=(1, 1))
    assert written() != first
    assert len(list((tmp_path / "cache").iterdir())) == 1


def test_a_damaged_cache_is_made_again(clip: Clip, tmp_path: Path) -> None:
    footage(clip, tmp_path / "cache")
    path = next((tmp_path / "cache").glob("*/color.npy"))
    path.write_bytes(path.read_bytes()[:200])
    assert footage(clip, tmp_path / "cache").arrays["color"].shape[0] == 9


def test_a_full_disk_leaves_no_cache(clip: Clip, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object, **__: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(np.lib.format, "write_array_header_1_0", full)
    with pytest.raises(ClipError, match="No space left"):
        footage(clip, tmp_path / "cache")
    assert list((tmp_path / "cache").iterdir()) == []


# Crops.


class Watched(np.ndarray):
    """An array that adds up how much of it was read."""

    read = 0

    def __getitem__(self, key: object) -> np.ndarray:  # type: ignore[override]
        part: np.ndarray = np.asarray(self)[key]  # type: ignore[index]
        self.read += part.size
        return part


def test_a_crop_reads_its_own_pixels_only(source: Footage) -> None:
    arrays = {name: np.array(array).view(Watched) for name, array in source.arrays.items()}
    part = window(replace(source, arrays=arrays), (4, 8), (10, 12), ("color", "motion2", "motion", "depth"))
    part.every(2)[1]
    assert {name for name, array in arrays.items() if array.read} == {"color", "motion2", "motion", "depth"}
    assert arrays["color"].read == 3 * 10 * 12


def test_the_camera_of_a_crop_sees_the_crop(source: Footage) -> None:
    """Motion that the cameras cause is the same, in pixels, in a crop as at the same place of the whole."""
    records = list(source.clip.records)
    tilted = perspective(0.9, 40 / 24)
    tilted[0, 2], tilted[1, 2] = 0.1, -0.2
    rows = tuple(tuple(row) for row in tilted.tolist())
    records = [replace(r, projection=rows) for r in records]
    source = replace(source, clip=replace(source.clip, records=tuple(records)))
    whole, part = source.clip, window(source, (4, 8), (10, 12))
    expected = camera_motion(whole[4], whole[2])[..., 4:14, 8:20]
    torch.testing.assert_close(camera_motion(part[4], part[2]), expected, atol=1e-3, rtol=1e-4)


# Samples.


def samples(source: Footage, seed: int = 0, **changes: object) -> Samples:
    return Samples([source], replace(SMALL, **changes), fields=FIELDS, seed=seed)


def equal(a: object, b: object) -> bool:
    leaves = zip(torch.utils._pytree.tree_leaves(a), torch.utils._pytree.tree_leaves(b), strict=True)
    return all(torch.equal(x, y) for x, y in leaves if isinstance(x, Tensor))


def test_samples_follow_from_seed_and_number(source: Footage) -> None:
    one = samples(source)
    assert equal(one[7].frames, samples(source)[7].frames)
    assert not equal(one[7].frames, one[8].frames)
    assert not equal(one[7].frames, samples(source, seed=1)[7].frames)


def test_vectors_reach_the_last_shaded_frame_or_the_one_between(source: Footage) -> None:
    """Methods that keep what they made of unshaded frames ask for vectors to those."""
    recipe = replace(SMALL, mode="alternate", shaded=2, truths=1)
    gap, step = (
        Samples([source], recipe, fields=FIELDS, seed=0, motion=motion)[3].frames for motion in ("gap", "step")
    )
    for one, other, reach in zip(gap, step, (2, 1, 2, 1), strict=True):
        assert (float(one.span), float(other.span)) == (reach, 1)
        assert one.is_shaded == (reach == 2)


@pytest.mark.parametrize("mode", ["extrapolate", "interpolate"])
def test_a_sample_is_three_shaded_frames_and_one_to_generate(source: Footage, mode: str) -> None:
    sample = samples(source, mode=mode, stops=0.0)[3]
    start = float(sample.frames[0].time)
    hidden = 5 if mode == "extrapolate" else 3
    assert [float(f.time) - start for f in sample.frames] == [0, 2, 4, hidden]
    assert [f.is_shaded for f in sample.frames] == [True, True, True, False]
    assert [bool(f.reset) for f in sample.frames[:3]] == [True, False, False]
    assert [float(f.span) for f in sample.frames] == [2, 2, 2, 1]
    truth = source.clip[int(start) + hidden].color
    assert truth is not None
    assert set(sample.targets.flatten().tolist()) <= set(truth.flatten().tolist())


def test_exposure_is_one_factor_for_a_sample(source: Footage) -> None:
    plain, bright = samples(source, stops=0.0)[3], samples(source, stops=2.0)[3]
    gain = bright.targets / plain.targets
    assert float(gain.max() - gain.min()) < 1e-4
    assert abs(float(gain.mean()) - 1) > 1e-3
    for a, b in zip(plain.frames[:3], bright.frames[:3], strict=True):
        torch.testing.assert_close(b.color, a.color * gain.mean())


def test_no_sample_crosses_a_cut(clip: Clip, tmp_path: Path) -> None:
    records = tuple(replace(r, cut=index == 2) for index, r in enumerate(clip.records))
    source = footage(replace(clip, records=records), tmp_path / "cache")
    assert {int(samples(source)[n].frames[0].time) for n in range(12)} == {2, 3}


def smaller(source: Footage, height: int, width: int, *, cameras: bool = True) -> Footage:
    """The top left corner of a clip, as a clip of its own."""
    records = source.clip.records if cameras else [replace(r, view=None, projection=None) for r in source.clip.records]
    part = replace(source.clip, size=(height, width), records=tuple(records))
    return Footage(part, {name: array[..., :height, :width] for name, array in source.arrays.items()})


def test_clips_of_several_sizes_make_samples_of_one(source: Footage) -> None:
    """As large as the smallest clip, where the crop is larger; else nothing changes."""
    for crop, size in (((64, 32), (12, 30)), ((16, 16), (12, 16)), ((10, 10), (10, 10))):
        many = Samples([source, smaller(source, 12, 30)], replace(SMALL, crop=crop), fields=FIELDS, seed=0)
        batch = next(batches(many, 0))
        assert batch.targets.shape[-2:] == size
        assert all(frame.size == size for frame in batch.frames)


def test_cameras_that_some_clips_lack_are_left_out_where_nobody_asks_for_them(source: Footage) -> None:
    fields = [name for name in FIELDS if name not in ("view", "projection")]
    sources = [source, smaller(source, 16, 16, cameras=False)]
    for batch in batches(Samples(sources, SMALL, fields=fields, seed=0), 0):
        assert all(frame.view is None and frame.projection is None for frame in batch.frames)


def test_samples_that_are_too_small_are_refused(source: Footage) -> None:
    with pytest.raises(ClipError, match=r"has 7x12 pixels, and samples need at least 8 either way"):
        Samples([source, smaller(source, 12, 7)], SMALL, fields=FIELDS, seed=0)
    with pytest.raises(ClipError, match="crops of 4 pixels are too small"):
        samples(source, crop=(16, 4))


def test_clips_that_are_too_short_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ClipError, match="6 frames of one shot"):
        samples(footage(write_shots(tmp_path / "short", 5), tmp_path / "cache"))


def test_missing_references_are_refused(source: Footage) -> None:
    with pytest.raises(ClipError, match="no references 2 times"):
        Samples([source], SMALL, fields=FIELDS, seed=0, scale=2)


def test_workers_change_nothing(source: Footage) -> None:
    alone, helped = (list(batches(samples(source), 1, workers=n)) for n in (0, 2))
    assert len(alone) == 2
    assert equal([(b.frames, b.targets) for b in alone], [(b.frames, b.targets) for b in helped])
    assert [b.names for b in alone] == [b.names for b in helped]


def test_processes_share_out_the_samples_of_a_step(source: Footage) -> None:
    whole = next(batches(samples(source), 2))
    parts = [next(batches(samples(source), 2, rank=rank, world=2)) for rank in (0, 1)]
    assert equal((whole.frames, whole.targets), (joined(parts).frames, joined(parts).targets))
    with pytest.raises(ValueError, match="cannot be shared by 3"):
        batches(samples(source), 0, world=3)


def test_records_without_cameras_are_kept() -> None:
    from framecast.data import _narrowed

    record = Record(number=1, time=0.0)
    assert _narrowed(record, (0, 0), (4, 4), (8, 8)) == record
