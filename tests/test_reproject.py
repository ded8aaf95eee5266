"""Shaded frames seen from others: exact motion, light without texture, holes and what fills them, occluders."""

import math
from dataclasses import replace

import pytest
import torch
import torch.nn.functional as F
from passing import H, W, shot
from torch import Tensor

from framecast.frame import SKY, Frame, perspective, unshaded
from framecast.methods.reproject import (
    PLACES,
    Geometry,
    _filled_at,
    filled,
    geometry,
    light,
    likeness,
    occluder_motion,
    steps,
    surface,
    valid,
)
from framecast.methods.warps import OcclusionWarp, Warp
from framecast.warp import chain, inside, warp

# Motion.


def test_two_rigid_translations_chain_to_their_sum() -> None:
    first = torch.tensor([2.0, -3.0]).view(1, 2, 1, 1).expand(1, 2, H, W)
    second = torch.tensor([-4.0, 1.0]).view(1, 2, 1, 1).expand(1, 2, H, W)
    depth = torch.full((1, 1, H, W), 3.0)
    torch.testing.assert_close(chain([first, second], [depth, depth]), first + second)


def test_a_surface_hidden_in_between_keeps_its_velocity_over_unequal_gaps() -> None:
    """One pixel of its own, covered in the other frame: 3 pixels in one frame are 6 in two."""
    motion, other = torch.zeros(1, 2, 5, 5), torch.full((1, 2, 5, 5), 9.0)
    motion[:, 0] = 1.5
    near, far = torch.full((1, 1, 5, 5), 1.0), torch.full((1, 1, 5, 5), 8.0)
    total = chain([motion, other], [far, near], [torch.tensor([1.0]), torch.tensor([2.0])])
    torch.testing.assert_close(total[:, 0], torch.full((1, 5, 5), 4.5))


def test_motion_is_scaled_where_vectors_reach_elsewhere() -> None:
    """Vectors over two frames, the shaded frame half as far: half the vectors."""
    frame = shot(5.0, span=2.0)
    motion = steps(frame, torch.tensor([4.0]), torch.zeros(1, 2))
    torch.testing.assert_close(motion[:, 0], torch.full((1, H, W), -3.0))


def test_jitter_is_part_of_the_motion() -> None:
    """A wall that stands still, sampled at other places: the warp is closer than the frame as it is."""
    last, now = shot(4.0, speed=0, jitter=(-0.4, 0.3)), shot(5.0, speed=0, jitter=(0.4, -0.3), span=1.0)
    image, _ = Warp()(unshaded(now), Warp().start(last))
    inner = (..., slice(2, -2), slice(2, -2))
    assert now.color is not None
    assert last.color is not None
    error, before = (image - now.color)[inner].abs().mean(), (last.color - now.color)[inner].abs().mean()
    assert error < 0.25 * before


# Light and surfaces.


def test_light_times_surface_is_colour_also_at_the_sky_and_on_black() -> None:
    frame = shot(0)
    assert frame.depth is not None
    assert frame.albedo is not None
    depth, albedo = frame.depth.clone(), frame.albedo.clone()
    depth[..., :4, :], albedo[..., :8] = SKY, 0
    frame = replace(frame, depth=depth, albedo=albedo)
    torch.testing.assert_close(torch.expm1(light(frame)) * surface(frame), frame.color)
    assert bool((surface(frame)[..., :4, :] == 1).all())
    assert float(surface(frame).min()) == pytest.approx(0.04)


# Holes.


def moved(frame: Frame, **changes: object) -> Tensor:
    """Which pixels of a standing scene are valid when the past frame differs by `changes`."""
    past = replace(frame, **changes)
    zero = torch.zeros(1, 2, H, W)
    return valid(geometry(frame), geometry(past), zero)


def test_a_frame_is_valid_in_itself() -> None:
    assert bool(moved(shot(0, square=1.0)).all())


@pytest.mark.parametrize(("degrees", "expected"), [(0, True), (5, True), (20, False), (175, False)])
def test_turned_normals_are_holes_on_moving_things(degrees: float, expected: bool) -> None:
    frame = replace(shot(0), object=torch.full((1, 1, H, W), 3, dtype=torch.int32))
    angle = torch.tensor(degrees).deg2rad()
    turned = torch.stack((angle.sin(), angle * 0, angle.cos())).view(1, 3, 1, 1).expand(1, 3, H, W)
    assert bool(moved(frame, normal=turned).all()) == expected
    assert bool(moved(frame, normal=turned).any()) == expected


def test_normals_do_not_count_on_the_static_world() -> None:
    frame = shot(0)
    assert bool(moved(frame, normal=torch.ones(1, 3, H, W)).all())


def test_another_object_is_a_hole() -> None:
    frame = shot(0)
    other = torch.zeros(1, 1, H, W, dtype=torch.int32)
    other[..., 10:12, 20:22] = 5
    found = ~moved(frame, object=other)
    assert torch.equal(found, other > 0)


def test_another_place_is_a_hole_on_the_static_world() -> None:
    frame = shot(0)
    assert frame.depth is not None
    depth = frame.depth.clone()
    depth[..., 10, 20] = 3.0
    found = ~moved(frame, depth=depth)
    assert int(found.sum()) == 1
    assert bool(found[0, 0, 10, 20])
    assert bool(moved(frame, depth=frame.depth + 0.02).all())


def test_beyond_the_border_is_a_hole() -> None:
    frame = shot(0, speed=0)
    motion = torch.zeros(1, 2, H, W)
    motion[:, 0] = -2.6
    wide = replace(frame, depth=torch.full((1, 1, H, W), 500.0))  # tolerance far above the shift
    assert torch.equal(valid(geometry(wide), geometry(wide), motion), inside(motion))


def test_perspective_disocclusion_is_exactly_what_was_hidden() -> None:
    """A camera steps aside: the wall behind a pillar that was hidden is a hole, the rest is not."""
    projection, view = perspective(1.0, W / H)[None], torch.eye(4)[None]
    depth = torch.full((1, 1, H, W), 10.0)
    frame = replace(shot(0), projection=projection, view=view, depth=depth)
    pillar = depth.clone()
    pillar[..., 18:22] = 4.0
    past = replace(frame, depth=pillar)
    seen = valid(geometry(frame), geometry(past), torch.zeros(1, 2, H, W))
    assert torch.equal(seen, pillar > 5)


def test_what_is_valid_like_a_brute_force_twin() -> None:
    """Every pixel that a bilinear read mixes is joined; the nearest shows the same position, all of them the normal."""
    generator = torch.Generator().manual_seed(5)

    def noise(channels: int) -> Tensor:
        return torch.rand(1, channels, H, W, generator=generator)

    frame = replace(shot(0), object=(noise(1) > 0.9).int() * 3, depth=300 + noise(1) + 27 * (noise(1) > 0.97))
    other = torch.where(noise(1) > 0.95, 5, frame.object)
    past = replace(frame, object=other, depth=frame.depth + 4 * noise(1), normal=F.normalize(noise(3) - 0.2, dim=1))
    now, then = geometry(frame), geometry(past)
    motion = torch.where(noise(2) > 0.5, torch.randint(-2, 3, (1, 2, H, W), generator=generator), 3 * noise(2) - 1.5)
    found, turned = valid(now, then, motion.float()), warp(then.normal, motion.float())

    def limit(seen: Geometry, i: int, j: int) -> float:
        facing = float(seen.facing[0, 0, i, j])
        return float(seen.depth[0, 0, i, j]) * (0.0075 * facing + 0.045 * (1 - facing) + 0.005)

    def apart(a: Geometry, i: int, j: int, b: Geometry, k: int, m: int) -> float:
        return float((a.position[0, :, i, j] - b.position[0, :, k, m]).norm())

    def alike(i: int, j: int, k: int, m: int) -> bool:
        ids = int(then.object[0, 0, i, j]), int(then.object[0, 0, k, m])
        return ids[0] == ids[1] and (ids[0] != 0 or apart(then, i, j, then, k, m) <= 2 * limit(then, i, j))

    def shows(i: int, j: int) -> bool:
        x, y = j + float(motion[0, 0, i, j]), i + float(motion[0, 1, i, j])
        if not (-0.5 <= x <= W - 0.5 and -0.5 <= y <= H - 0.5):
            return False

        def on(at: float, shift: float, end: int) -> int:
            return min(max(math.floor(at + shift), 0), end - 1)

        row, column = on(y, 0.5, H), on(x, 0.5, W)
        top, left, low, right = on(y, 0.01, H), on(x, 0.01, W), on(y, 0.99, H), on(x, 0.99, W)
        if not all(alike(top, left, k, m) for k in {top, low} for m in {left, right}):
            return False
        if int(then.object[0, 0, row, column]) != int(now.object[0, 0, i, j]):
            return False
        if int(now.object[0, 0, i, j]) == 0:
            return apart(now, i, j, then, row, column) <= limit(now, i, j)
        return float((now.normal[0, :, i, j] * turned[0, :, i, j]).sum() / turned[0, :, i, j].norm()) >= 0.98

    expected = torch.tensor([[shows(i, j) for j in range(W)] for i in range(H)])
    assert 0.2 < float(expected.float().mean()) < 0.8
    assert float((found[0, 0] != expected).float().mean()) < 0.005  # at limits, within rounding


# Occluders.


def test_occlusion_motion_reads_background_beside_a_moving_square() -> None:
    """A square moves 6 pixels to the right over a standing wall: what it uncovers is read left of it, never from it."""
    last, now = shot(4.0, speed=0, square=3.0), shot(6.0, speed=0, square=3.0)
    assert now.depth is not None
    assert now.motion is not None
    assert last.object is not None
    assert now.object is not None
    uncovered = (last.object == 7) & (now.object == 0)
    assert int(uncovered.sum()) == 6 * 8
    followed = occluder_motion(now.depth, now.motion)
    assert torch.equal(followed[:, 0][uncovered[:, 0]], torch.full((48,), -6.0))
    image, _ = OcclusionWarp()(unshaded(now), OcclusionWarp().start(last))
    plain, _ = Warp()(unshaded(now), Warp().start(last))
    assert last.color is not None
    beside = torch.roll(last.color, 6, 3)
    where = uncovered.expand(-1, 3, -1, -1)
    torch.testing.assert_close(image[where], beside[where], atol=1e-4, rtol=0)
    torch.testing.assert_close(plain[where], torch.full((144,), 0.05), atol=1e-4, rtol=0)


def test_without_an_occluder_pixels_keep_their_motion() -> None:
    depth, motion = torch.full((1, 1, H, W), 4.0), torch.full((1, 2, H, W), 2.0)
    assert torch.equal(occluder_motion(depth, motion), motion)


def test_holes_are_filled_like_a_brute_force_twin() -> None:
    generator = torch.Generator().manual_seed(3)
    now = geometry(shot(5.0))
    height, width = now.depth.shape[-2:]

    def noise(channels: int) -> Tensor:
        return torch.rand(1, channels, height, width, generator=generator)

    now = replace(now, normal=F.normalize(noise(3) - 0.3, dim=1), depth=3 + noise(1))
    fallback, finish = noise(3), noise(2)
    seen = [(noise(3), noise(1) > part) for part in (0.8, 0.7, 0.5)]
    surfaces = likeness(now.normal, now.depth, finish)
    found = filled(seen, fallback, surfaces)
    known = seen[2][1] | seen[1][1] | seen[0][1]
    base = torch.where(seen[2][1], seen[2][0], torch.where(seen[1][1], seen[1][0], seen[0][0]))
    torch.testing.assert_close(found * known, base * known)
    everywhere = _filled_at(torch.arange(known.numel()), base, known, surfaces, fallback)
    torch.testing.assert_close(everywhere, found, rtol=1e-4, atol=1e-5)
    holes = (~known)[0, 0].nonzero()
    assert len(holes) > 50
    for row, column in holes[::7].tolist():
        total, weights = 1e-3 * fallback[0, :, row, column], 1e-3
        for x, y in PLACES:
            i, j = row + y, column + x
            if 0 <= i < height and 0 <= j < width and known[0, 0, i, j]:
                turned = float((now.normal[0, :, i, j] - now.normal[0, :, row, column]).square().sum()) / 0.35**2
                deeper = math.log(float(now.depth[0, 0, i, j] / now.depth[0, 0, row, column])) / 0.08
                other = float(((finish[0, :, i, j] - finish[0, :, row, column]) / 0.2).square().sum())
                weight = math.exp(-turned - deeper**2 - other) / (x * x + y * y)
                total, weights = total + weight * base[0, :, i, j], weights + weight
        torch.testing.assert_close(found[0, :, row, column], total / weights, rtol=1e-4, atol=1e-5)
