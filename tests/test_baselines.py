"""Laws of the methods that others are compared with: hold, blend, the 3D warp, bidirectional reprojection."""

import math
from dataclasses import replace

import pytest
import torch
from conftest import disc_frame
from torch import nn

from framecast.frame import SKY, Frame, camera_motion, moment, perspective
from framecast.methods import bsr, mesh, warp3d
from framecast.methods.blend import Blend
from framecast.methods.bsr import BSR
from framecast.methods.hold import Hold
from framecast.methods.pair import Pair, begin
from framecast.methods.warp3d import Warp3D

LENS = perspective(math.pi / 2, 48 / 32)[None]
"""One scene unit at depth 1 is 16 pixels of a 48 x 32 image."""

BOTH = pytest.mark.parametrize("method", [Warp3D(), Warp3D(warp3d.Config(mesh=True))], ids=["points", "mesh"])


def looking(x: float = 0, z: float = 0, yaw: float = 0) -> torch.Tensor:
    """View matrix of a camera at (x, 0, z) turned about the vertical axis."""
    c, s = math.cos(yaw), math.sin(yaw)
    turn = torch.tensor([[c, 0, -s, 0], [0, 1, 0, 0], [s, 0, c, 0], [0, 0, 0, 1]])
    move = torch.eye(4)
    move[0, 3], move[2, 3] = -x, -z
    return (turn @ move)[None]


def wall_frame(time: float, *, shift: float, depth: float = 4, height: int = 32, width: int = 48) -> Frame:
    """A textured wall whose picture moves right by `shift` pixels a frame because the camera moves left."""
    y, x = torch.meshgrid(torch.arange(height) + 0.5, torch.arange(width) + 0.5, indexing="ij")
    texture = 0.5 + 0.3 * torch.sin((x - shift * time) * 0.35) * torch.cos(y * 0.3)
    motion = torch.zeros(1, 2, height, width)
    motion[:, 0] = -2 * shift
    return Frame(
        color=texture.expand(1, 3, -1, -1).contiguous(),
        depth=torch.full((1, 1, height, width), float(depth)),
        motion=motion,
        motion_next=-motion,
        jitter=torch.zeros(1, 2),
        view=looking(x=-shift * time * depth / 16),
        projection=LENS,
        time=torch.tensor([float(time)]),
        reset=torch.tensor([time == 0]),
        span=torch.tensor([2.0]),
    )


def image_at(method: nn.Module, frames: list[Frame], time: float) -> torch.Tensor:
    """What the method makes for a time after the shaded frames arrived."""
    state = method.start(frames[0])
    for frame in frames:
        _, state = method(frame, state)
    return method(moment(time), state)[0]


def psnr(image: torch.Tensor, truth: torch.Tensor | None) -> float:
    assert truth is not None
    return -10 * math.log10(float(((image - truth) ** 2).mean()))


def test_hold_repeats_the_nearer_frame_and_the_earlier_where_tied() -> None:
    frames = [disc_frame(0), disc_frame(2)]
    for time, expected in ((0.0, 0), (0.9, 0), (1.0, 0), (1.1, 1), (2.0, 1), (3.7, 1)):
        assert torch.equal(image_at(Hold(), frames, time), frames[expected].color)


def test_blend_mixes_by_time_and_holds_beyond() -> None:
    frames = [disc_frame(0), disc_frame(2)]
    assert frames[0].color is not None
    assert frames[1].color is not None
    for time, weight in ((0.0, 0.0), (0.5, 0.25), (1.5, 0.75), (2.0, 1.0), (3.0, 1.0)):
        expected = frames[0].color * (1 - weight) + frames[1].color * weight
        torch.testing.assert_close(image_at(Blend(), frames, time), expected)


def test_position_runs_from_the_previous_to_the_current_frame() -> None:
    pair = Pair(prev=moment(4), current=moment(6))
    assert [pair.position(torch.tensor([t])).item() for t in (4.0, 5.0, 6.0, 9.0)] == [0, 0.5, 1, 2.5]
    alone = begin(moment(4), ())
    assert [alone.position(torch.tensor([t])).item() for t in (3.0, 4.0, 9.0)] == [1, 1, 1]


def test_a_fresh_frame_keeps_only_motion_to_what_follows() -> None:
    frame = disc_frame(0)
    assert frame.motion is not None
    assert frame.motion_next is not None
    kept = begin(frame, ("color", "motion", "motion_next")).current
    assert kept.motion is not None
    assert torch.equal(kept.motion, -frame.motion_next)
    assert kept.depth is None
    kept = begin(replace(frame, motion_next=None), ("color", "motion")).current
    assert kept.motion is not None
    assert not kept.motion.any()


@pytest.mark.parametrize("time", [1.0, 1.5, 3.0])
@BOTH
def test_3d_warp_shows_a_wall_from_where_the_camera_is(method: Warp3D, time: float) -> None:
    """The wall's picture moves 3 pixels a frame; away from the border the generated image is the real one."""
    frames = [wall_frame(t, shift=3) for t in (0, 2)]
    inner = (..., slice(1, -1), slice(12, -12))
    truth = wall_frame(time, shift=3).color
    assert truth is not None
    torch.testing.assert_close(image_at(method, frames, time)[inner], truth[inner], atol=8e-3, rtol=0)


def test_reprojection_is_the_motion_that_the_cameras_cause() -> None:
    """Against the same quantity by way of world positions."""
    frame = replace(wall_frame(0, shift=3), depth=2 + 5 * torch.rand(1, 1, 32, 48), view=looking(0.3, 1, 0.2))
    other = replace(frame, view=looking(-0.4, 0.7, 0.25), projection=perspective(1.3, 1.5)[None])
    assert other.view is not None
    assert other.projection is not None
    motion, depth = warp3d.reproject(frame, other.view, other.projection)
    torch.testing.assert_close(motion, camera_motion(frame, other), atol=2e-3, rtol=0)
    still, same = warp3d.reproject(other, other.view, other.projection)
    assert float(still.abs().max()) < 1e-4
    torch.testing.assert_close(same, other.depth)
    assert float((depth - same).abs().min()) > 1e-3


def test_reprojection_drops_what_is_behind_the_camera() -> None:
    frame = wall_frame(0, shift=0, depth=4)
    assert frame.projection is not None
    motion, depth = warp3d.reproject(frame, looking(z=-6), frame.projection)
    assert not depth.any()
    assert bool((motion.abs() > 48 + 32).all())


def test_orthographic_cameras_shift_all_depths_alike() -> None:
    lens = torch.diag(torch.tensor([1 / 3, 1 / 2, -0.01, 1.0]))[None]  # 16 pixels a unit at every depth
    frame = replace(wall_frame(0, shift=0), depth=2 + 5 * torch.rand(1, 1, 32, 48), projection=lens)
    motion, depth = warp3d.reproject(frame, looking(x=0.5), lens)
    torch.testing.assert_close(motion[:, 0], torch.full_like(motion[:, 0], -0.5 * 48 / 6))
    torch.testing.assert_close(depth, frame.depth)


def test_rotations_by_part_add_up() -> None:
    whole = (looking(yaw=0.7) @ torch.tensor([[1.0, 0, 0, 0], [0, 0.8, -0.6, 0], [0, 0.6, 0.8, 0], [0, 0, 0, 1]]))[
        :, :3, :3
    ]
    part = torch.full((1, 1, 1), 1 / 3)
    third = warp3d.turned(whole, part)
    torch.testing.assert_close(third @ third @ third, whole, atol=1e-6, rtol=0)
    torch.testing.assert_close(third.mT @ third, torch.eye(3)[None], atol=1e-6, rtol=0)
    torch.testing.assert_close(warp3d.turned(whole, 3 * part), whole, atol=1e-6, rtol=0)
    torch.testing.assert_close(warp3d.turned(looking(yaw=0.2)[:, :3, :3], 9 * part), looking(yaw=0.6)[:, :3, :3])
    assert torch.equal(warp3d.turned(torch.eye(3)[None], part), torch.eye(3)[None])


def test_the_pose_lies_between_and_beyond_the_two() -> None:
    frames = [replace(moment(t), view=looking(t, 0, 0.1 * t), projection=LENS) for t in (0, 2)]
    for t in (0.5, 3.0):
        view, projection = warp3d.camera(Pair(*frames), torch.full((1, 1, 1, 1), t / 2))
        torch.testing.assert_close(view, looking(t, 0, 0.1 * t), atol=1e-6, rtol=0)
        assert torch.equal(projection, LENS)


def test_the_pose_is_exact_where_networks_are_rounded() -> None:
    """The 3D warp before a network runs under its autocast, whose products have eight bits."""
    frames = [replace(moment(t), view=looking(700.0 + t, 0, 0.1 * t), projection=LENS) for t in (0, 2)]
    with torch.autocast("cpu", torch.bfloat16):
        view, _ = warp3d.camera(Pair(*frames), torch.full((1, 1, 1, 1), 0.5))
    torch.testing.assert_close(view, looking(701.0, 0, 0.1), atol=1e-3, rtol=0)


@pytest.mark.parametrize("stretch", [1.0, 1.3, 1.5])
def test_points_cover_stretched_surfaces_without_cracks(stretch: float) -> None:
    x = torch.arange(24.0) - 12
    motion = torch.stack(torch.meshgrid(x, x, indexing="xy"))[None] * (stretch - 1)
    back, depth, rank = warp3d.points(motion, torch.ones(1, 1, 24, 24))
    assert not rank[..., 2:-2, 2:-2].any()
    assert float(depth.min()) == float(depth.max()) == 1
    expected = motion / stretch  # of the point that lands exactly there; a neighbour's differs by its distance
    assert float((back + expected)[..., 2:-2, 2:-2].abs().max()) <= 0.75 * (stretch - 1) + 1e-5


def test_the_nearer_point_hides_the_farther() -> None:
    depth = torch.full((1, 1, 8, 8), 5.0)
    depth[..., 4, 2] = 2
    motion = torch.zeros(1, 2, 8, 8)
    motion[:, 0, 4, 2] = 3
    back, seen, rank = warp3d.points(motion, depth)
    assert seen[0, 0, 4, 5] == 2
    assert back[0, :, 4, 5].tolist() == [-3, 0]
    assert rank[0, 0, 4, 2] == 2
    assert int((rank > 0).sum()) == 1


def brute_mesh(motion: torch.Tensor, depth: torch.Tensor, source: torch.Tensor, skin: float) -> list[list[tuple]]:
    """(rank, depth, x and y of the motion) at each pixel, triangle by triangle in double precision."""
    h, w = depth.shape
    best: list[list[tuple]] = [[(2, 0.0, 0.0, 0.0)] * w for _ in range(h)]
    for j in range(h - 1):
        for i in range(w - 1):
            for tri in (((i, j), (i + 1, j), (i, j + 1)), ((i + 1, j + 1), (i, j + 1), (i + 1, j))):
                p = [(x + float(motion[0, y, x]), y + float(motion[1, y, x])) for x, y in tri]
                d = [float(depth[y, x]) for x, y in tri]
                s = [float(source[y, x]) for x, y in tri]
                area = (p[1][0] - p[0][0]) * (p[2][1] - p[0][1]) - (p[1][1] - p[0][1]) * (p[2][0] - p[0][0])
                for y in range(h):
                    for x in range(w):
                        b = []
                        for k in range(3):
                            (ax, ay), (bx, by) = p[(k + 1) % 3], p[(k + 2) % 3]
                            b.append(((bx - ax) * (y - ay) - (by - ay) * (x - ax)) / area)
                        if min(b) < -1e-4:
                            continue
                        z = 1 / sum(bk / dk for bk, dk in zip(b, d, strict=True))
                        dx = sum(bk * t[0] for bk, t in zip(b, tri, strict=True)) - x
                        dy = sum(bk * t[1] for bk, t in zip(b, tri, strict=True)) - y
                        best[y][x] = min(best[y][x], (int(max(s) > min(s) * (1 + skin)), z, dx, dy))
    return best


def test_mesh_equals_its_brute_force_twin() -> None:
    motion, depth, source = torch.randn(1, 2, 6, 7) * 1.5, 1 + torch.rand(1, 1, 6, 7), 1 + 0.1 * torch.rand(1, 1, 6, 7)
    back, z, rank = mesh.rasterize(motion, depth, source, 0.05)
    expected = torch.tensor(brute_mesh(motion[0], depth[0, 0], source[0, 0], 0.05)).permute(2, 0, 1)
    assert {0.0, 1.0} <= set(rank.unique().tolist())
    torch.testing.assert_close(rank[0, 0], expected[0])
    torch.testing.assert_close(z[0, 0], expected[1], atol=1e-4, rtol=1e-4)
    torch.testing.assert_close(back[0], expected[2:], atol=2e-3, rtol=0)


def test_a_skin_stretches_over_the_hole_and_hides_nothing() -> None:
    """A near square moves 3 pixels to the right over a wall: a rubber sheet on its left, the square before the wall."""
    depth = torch.full((1, 1, 12, 20), 5.0)
    depth[..., 3:9, 5:11] = 2
    motion = torch.zeros(1, 2, 12, 20)
    motion[:, 0] = torch.where(depth[:, 0] == 2, 3.0, 0.0)
    _, z, rank = mesh.rasterize(motion, depth, depth, 0.05)
    assert bool((rank[0, 0, 4:8, 5:8] == 1).all())
    assert bool((rank[0, 0, 4:8, 8:14] == 0).all())
    assert bool((z[0, 0, 4:8, 8:14] == 2).all())
    assert bool((rank[0, 0, 4:8, 14:] == 0).all())
    assert bool((z[0, 0, 4:8, 14:] == 5).all())


def view(color: float, depth: float, rank: float) -> warp3d.View:
    return warp3d.View(torch.full((1, 3, 1, 1), color), *(torch.full((1, 1, 1, 1), float(v)) for v in (depth, rank)))


@pytest.mark.parametrize(
    ("prev", "current", "at", "color"),
    [
        ((0.2, 5, 0), (0.6, 5, 0), 0.25, 0.3),  # one surface: mixed by time
        ((0.2, 5, 0), (0.6, 2, 0), 0.25, 0.2),  # two: the nearer in time
        ((0.2, 5, 0), (0.6, 2, 0), 0.75, 0.6),
        ((0.2, 5, 0), (0.6, 2, 1), 0.75, 0.2),  # a surface beats a skin
        ((0.2, 5, 2), (0.6, 2, 1), 0.25, 0.6),  # a skin beats nothing
    ],
)
def test_two_references_become_one_image(prev: tuple, current: tuple, at: float, color: float) -> None:
    both = warp3d.composite(view(*prev), view(*current), torch.full((1, 1, 1, 1), at), 0.05)
    torch.testing.assert_close(both.color, torch.full((1, 3, 1, 1), color))
    assert both.rank.item() == min(prev[2], current[2])


@pytest.mark.parametrize("size", [(16, 24), (13, 7), (1, 9)])
def test_holes_take_the_far_side(size: tuple[int, int]) -> None:
    """Left half near and red, right half far and green; a hole between them becomes green, but for smoothing."""
    color = torch.zeros(1, 3, *size)
    middle = size[1] // 2
    color[:, 0, :, :middle], color[:, 1, :, middle:] = 1, 1
    depth = torch.full((1, 1, *size), 5.0)
    depth[..., :middle] = 1
    mask = torch.ones(1, 1, *size, dtype=torch.bool)
    mask[..., middle] = False
    filled = warp3d.fill(torch.where(mask, color, 9.0), depth, mask)
    assert torch.equal(filled[:, :, :, :middle], color[:, :, :, :middle])
    assert bool((filled[:, 1, :, middle] >= 0.7).all())
    assert float(filled.max()) <= 1
    assert torch.equal(warp3d.fill(color, depth, torch.ones_like(mask)), color)


def test_fixed_points_solve_their_equation() -> None:
    """A field with a gentle slope: x + field(x) = p to a hundredth of a pixel."""
    y, x = torch.meshgrid(torch.arange(32.0), torch.arange(48.0), indexing="ij")
    field = torch.stack((2 + 0.1 * (x - 24), 1 + 0.05 * (y - 16)))[None]
    place = bsr.solve(field, field, 6)
    inner = (..., slice(6, -6), slice(8, -8))
    assert float(place.error[inner].max()) < 0.01
    expected = torch.stack(((x - 2 + 2.4) / 1.1 - x, (y - 1 + 0.8) / 1.05 - y))[None]
    torch.testing.assert_close(place.offset[inner], expected[inner], atol=0.02, rtol=0)


def test_places_off_the_image_lose() -> None:
    place = bsr.solve(torch.full((1, 2, 6, 6), 4.0), torch.full((1, 2, 6, 6), 4.0), 3)
    assert bool((place.error[..., :4, :] >= bsr.OUTSIDE).all())
    assert float(place.error[..., 4:, 4:].max()) < 1e-4


def test_another_start_finds_what_the_pixel_itself_does_not() -> None:
    """A small square jumps farther than its own size: only the other frame's vector leads back to it."""
    field, estimate = torch.zeros(1, 2, 9, 24), torch.zeros(1, 2, 9, 24)
    field[:, 0, 3:6, 4:7] = 10
    field[:, 0, :, 13:] = 3  # what is there now leads to 12, and 12 back
    estimate[:, 0, 3:6, 14:17] = 10
    found = bsr.solve(field, estimate, 3)
    assert found.offset[0, 0, 4, 15] == -10
    assert bsr.solve(field, torch.zeros_like(field), 3).offset[0, 0, 4, 15] != -10


@pytest.mark.parametrize("forward", [True, False])
@pytest.mark.parametrize("time", [1.0, 1.5, 3.0])
def test_reprojection_both_ways_moves_a_picture_exactly(time: float, forward: bool) -> None:
    frames = [wall_frame(t, shift=3) for t in (0, 2)]
    if not forward:
        frames = [replace(frame, motion_next=None) for frame in frames]
    inner = (..., slice(1, -1), slice(12, -12))
    truth = wall_frame(time, shift=3).color
    assert truth is not None
    torch.testing.assert_close(image_at(BSR(), frames, time)[inner], truth[inner], atol=8e-3, rtol=0)


def test_motion_of_another_span_is_scaled_to_the_gap() -> None:
    """Vectors to the frames left out, of constant acceleration, give the same fields as vectors over the gap."""
    pairs = [Pair(*(disc_frame(t, step=step) for t in (2, 4))) for step in (1, 2)]
    for single, double in zip(*(bsr.fields(pair) for pair in pairs), strict=True):
        torch.testing.assert_close(single, double, atol=1e-4, rtol=0)


def test_forward_motion_is_derived_where_it_was_not_rendered() -> None:
    """The disc keeps its vectors; the wall that it leaves free keeps none."""
    pair = Pair(*(disc_frame(t, step=2) for t in (2, 4)))
    bare = Pair(prev=replace(pair.prev, motion_next=None), current=pair.current)
    true, derived = bsr.fields(pair)[0], bsr.fields(bare)[0]
    assert float(((true - derived).abs() > 0.01).float().mean()) < 0.02
    assert float(derived.max()) > 5


@pytest.mark.parametrize(("visible", "shown"), [("nearer", 1.0), ("fitting", 0.0)])
def test_of_two_surfaces_the_nearer_or_the_better_fitting_one_is_seen(visible: str, shown: float) -> None:
    frames = [wall_frame(t, shift=0) for t in (0, 2)]
    dark, bright = torch.zeros(1, 3, 32, 48), torch.ones(1, 3, 32, 48)
    pair = Pair(
        prev=replace(frames[0], color=dark, depth=torch.full((1, 1, 32, 48), 4.0)),
        current=replace(frames[1], color=bright, depth=torch.full((1, 1, 32, 48), 2.0)),
    )
    offset = torch.zeros(1, 2, 32, 48)
    places = [bsr.Place(offset, torch.full((1, 1, 32, 48), e)) for e in (0.1, 0.4)]
    method = BSR(bsr.Config(visible=visible))  # type: ignore[arg-type]
    use1, mix = method.choose(pair, *places, offset, offset, torch.full((1, 1, 1, 1), 0.5))
    assert not mix.any()
    assert bool((use1 == bool(shown)).all())


def test_colours_that_agree_come_from_the_frame_nearer_in_time() -> None:
    frames = [wall_frame(t, shift=0) for t in (0, 2)]
    assert frames[0].color is not None
    for change, mixed in ((1.1, False), (2.0, True)):
        after = [frames[0], replace(frames[1], color=frames[0].color * change)]
        image = image_at(BSR(bsr.Config(color=0.13)), after, 0.5)
        assert torch.allclose(image, frames[0].color, atol=1e-3) != mixed
        assert not torch.allclose(image_at(BSR(), after, 0.5), frames[0].color, atol=1e-3)


def test_moving_things_need_motion_vectors() -> None:
    """The disc crosses a wall before a still camera: the 3D warp cannot know, reprojection both ways can."""
    frames = [replace(disc_frame(t, step=2), projection=LENS, reset=torch.tensor([t == 0])) for t in (0, 2, 4)]
    truth = disc_frame(3).color
    scores = {type(m).__name__: psnr(image_at(m, frames, 3.0), truth) for m in (Hold(), Blend(), Warp3D(), BSR())}
    assert scores["BSR"] > max(scores["Hold"], scores["Blend"], scores["Warp3D"]) + 5
    beyond = disc_frame(5).color
    assert psnr(image_at(BSR(), frames, 5.0), beyond) > psnr(image_at(Hold(), frames, 5.0), beyond) + 0.5


def test_the_sky_stays_where_the_camera_only_moves() -> None:
    frames = [replace(wall_frame(t, shift=3), depth=torch.full((1, 1, 32, 48), SKY)) for t in (0, 2)]
    image = image_at(Warp3D(), frames, 3.0)
    torch.testing.assert_close(image, frames[1].color, atol=2e-3, rtol=0)
