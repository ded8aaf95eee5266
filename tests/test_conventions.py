"""The executable half of `frame.py`: each convention as a law that one could see."""

import math
from pathlib import Path

import numpy as np
import pytest
import torch
from conftest import disc_frame

from framecast.clip import Clip, Record, finish, write_frame
from framecast.color import demodulate, modulate
from framecast.frame import (
    BUFFERS,
    SKY,
    Frame,
    camera_motion,
    concatenate,
    facing,
    inverse_depth,
    missing,
    moment,
    perspective,
    pixel_grid,
    project,
    unshaded,
    world_position,
)
from framecast.warp import fetch, warp

ZERO = torch.zeros(1)


def look(position: tuple[float, float, float], *, roll: float = 0.0) -> torch.Tensor:
    """World to camera of a camera at `position` that looks down -z, rolled counter-clockwise by `roll`."""
    c, s = math.cos(roll), math.sin(roll)
    camera = torch.tensor([[c, -s, 0, position[0]], [s, c, 0, position[1]], [0, 0, 1, position[2]], [0, 0, 0, 1]])
    return torch.linalg.inv(camera)[None]


def plane(depth: float, view: torch.Tensor, size: tuple[int, int] = (20, 30)) -> Frame:
    """A frame that sees a wall perpendicular to the axis everywhere at `depth`."""
    return Frame(
        depth=torch.full((1, 1, *size), depth),
        normal=torch.tensor([0.0, 0.0, 1.0]).view(1, 3, 1, 1).expand(1, 3, *size),
        jitter=torch.zeros(1, 2),
        view=view,
        projection=perspective(math.radians(60), size[1] / size[0])[None],
        time=torch.zeros(1),
        reset=torch.zeros(1, dtype=torch.bool),
        span=torch.ones(1),
    )


def test_pixel_centres_are_at_a_half() -> None:
    grid = pixel_grid(2, 3)
    assert grid[:, 0, 0].tolist() == [0.5, 0.5]
    assert grid[:, 1, 2].tolist() == [2.5, 1.5]


def test_motion_leads_from_the_current_to_the_previous_position() -> None:
    """A disc that moved right by 3.25 pixels is fetched from the left: motion x is negative."""
    now, before = disc_frame(1), disc_frame(0)
    disc = now.object == 1
    assert float(now.motion[:, :1][disc].mean()) == pytest.approx(-3.25)
    moved = fetch(before.object.float(), now.motion) == 1
    assert (moved & disc).sum() >= 0.95 * disc.sum()


def test_motion_next_leads_to_the_next_position() -> None:
    now, after = disc_frame(1), disc_frame(2)
    disc = now.object == 1
    found = fetch(after.object.float(), now.motion_next) == 1
    assert (found & disc).sum() >= 0.95 * disc.sum()


def test_motion_y_points_down() -> None:
    """Rows count from the top: motion y = +2 fetches from two rows below."""
    image = torch.arange(6.0).view(1, 1, 6, 1).expand(1, 1, 6, 4)
    motion = torch.zeros(1, 2, 6, 4)
    motion[:, 1] = 2
    assert warp(image, motion)[0, 0, :4, 0].tolist() == pytest.approx([2, 3, 4, 5], abs=1e-4)


def test_span_tells_how_far_vectors_reach(disc_clip: Clip) -> None:
    half = disc_clip.every(2)
    assert float(half[1].span) == 2
    assert float(disc_clip[1].span) == 1
    disc = half[1].object == 1
    assert float(half[1].motion[:, :1][disc].mean()) == pytest.approx(-7.0)  # x(0) - x(2)


def test_depth_is_the_distance_along_the_view_axis() -> None:
    """A wall at z = -4 seen from the origin has depth 4 in the corner of the image too, not the longer ray."""
    frame = plane(4.0, look((0, 0, 0)))
    position = world_position(frame.depth, frame.view, frame.projection)
    torch.testing.assert_close(position[:, 2], torch.full((1, 20, 30), -4.0))
    pixel, depth = project(position, frame.view, frame.projection)
    torch.testing.assert_close(depth, frame.depth)
    torch.testing.assert_close(pixel[0], pixel_grid(20, 30), atol=1e-4, rtol=0)


def test_positions_are_exact_where_networks_are_rounded() -> None:
    """Under autocast too: eight bits of a position of a thousand units would be wrong by four."""
    frame = plane(7.0, look((1000.0, -500.0, 300.0), roll=0.4))
    exact = world_position(frame.depth, frame.view, frame.projection)
    there, depth = project(exact, frame.view, frame.projection)
    with torch.autocast("cpu", torch.bfloat16):
        rounded = world_position(frame.depth, frame.view, frame.projection)
        assert torch.equal(rounded, exact)
        assert all(
            torch.equal(*pair)
            for pair in zip(project(rounded, frame.view, frame.projection), (there, depth), strict=True)
        )
    torch.testing.assert_close(there[0], pixel_grid(20, 30), atol=0.05, rtol=0)


def test_sky_fits_a_half_float_and_has_inverse_depth_zero() -> None:
    assert float(torch.tensor(SKY).half()) == SKY
    assert inverse_depth(torch.tensor([[[[SKY, 2.0]]]])).flatten().tolist() == [0, 0.5]


def test_world_is_right_handed_with_y_up() -> None:
    """The top right pixel of a camera that looks down -z shows a point at +x, +y."""
    frame = plane(4.0, look((0, 0, 0)))
    corner = world_position(frame.depth, frame.view, frame.projection)[0, :, 0, -1]
    assert corner[0] > 0
    assert corner[1] > 0
    assert corner[2] < 0


def test_camera_motion_of_a_sideways_step_is_focal_length_over_depth() -> None:
    """The camera steps right by 0.1: the wall was further right before... on screen it moves left."""
    now, before = plane(4.0, look((0.1, 0, 0))), plane(4.0, look((0, 0, 0)))
    focal = 10 / math.tan(math.radians(30))  # pixels, from the height of 20
    motion = camera_motion(now, before)
    torch.testing.assert_close(motion[:, 0], torch.full((1, 20, 30), 0.1 * focal / 4), atol=1e-4, rtol=0)
    torch.testing.assert_close(motion[:, 1], torch.zeros(1, 20, 30), atol=1e-4, rtol=0)


def test_camera_motion_of_a_step_up_points_up_in_the_image() -> None:
    now, before = plane(4.0, look((0, 0.1, 0))), plane(4.0, look((0, 0, 0)))
    assert (camera_motion(now, before)[:, 1] < 0).all()


def test_a_rolled_camera_turns_the_image_the_other_way() -> None:
    now, before = plane(4.0, look((0, 0, 0), roll=0.1)), plane(4.0, look((0, 0, 0)))
    right = camera_motion(now, before)[0, :, 10, 29]
    assert right[1] < 0  # content right of the centre came from higher up... it sank as the camera turned


def test_motion_of_the_sky_follows_the_turning_camera_only() -> None:
    here, moved = plane(SKY, look((0, 0, 0))), plane(SKY, look((1, 0, 0)))
    torch.testing.assert_close(camera_motion(here, moved), torch.zeros(1, 2, 20, 30), atol=2e-3, rtol=0)


def test_normals_are_in_world_space() -> None:
    """A wall that faces the camera has n·v = 1 at the centre, whatever the roll of the camera."""
    cosine = facing(plane(4.0, look((0.5, 0.2, 0), roll=0.7)))
    assert float(cosine[0, 0, 9:11, 14:16].mean()) == pytest.approx(1, abs=0.01)
    assert (cosine < 1.0001).all()


def test_jitter_is_where_in_the_pixel_the_sample_was_taken() -> None:
    """A ramp sampled at the pixel centre plus jitter: reading the image at minus jitter gives the centres back."""
    jitter = torch.tensor([[0.25, -0.375]])
    x, y = pixel_grid(8, 12) + jitter[0, :, None, None]
    frame = Frame(color=(x + 3 * y).expand(1, 3, 8, 12), jitter=jitter, time=ZERO, reset=ZERO > 0, span=ZERO + 1)
    centred = warp(frame.color, -frame.jitter[:, :, None, None].expand(1, 2, 8, 12))
    x, y = pixel_grid(8, 12)
    torch.testing.assert_close(centred[0, 0, 1:-1, 1:-1], (x + 3 * y)[1:-1, 1:-1], atol=1e-3, rtol=0)


def test_colour_is_linear_and_exposed(tmp_path: Path) -> None:
    """One stop more exposure doubles the stored values; dividing by the exposure gives the scene back."""
    scene = np.full((3, 4, 6), 0.3, np.float32)
    for number, exposure in ((1, 1.0), (2, 2.0)):
        write_frame(tmp_path, Record(number=number, time=number - 1, exposure=exposure), {"color": scene * exposure})
    clip = finish(tmp_path, fps=24)
    torch.testing.assert_close(clip[1].color, 2 * clip[0].color)
    for i in range(2):
        assert float(clip[i].color.mean()) / clip.shown[i].exposure == pytest.approx(0.3, rel=1e-3)


def test_object_0_is_the_static_world() -> None:
    """With a still camera whatever has object 0 has no motion, and whatever moves has another number."""
    frame = disc_frame(1)
    assert (frame.motion[:, :, frame.object[0, 0] == 0] == 0).all()
    assert (frame.motion[:, 0][frame.object[:, 0] != 0] != 0).all()


def test_albedo_is_what_light_is_multiplied_with() -> None:
    """Linear base colour: light times albedo is colour, so a half as bright surface is a half as bright picture."""
    light, albedo = torch.rand(1, 3, 4, 4), torch.full((1, 3, 4, 4), 0.5)
    torch.testing.assert_close(modulate(light, albedo), light / 2)
    torch.testing.assert_close(demodulate(modulate(light, albedo), albedo), light)


def test_only_the_first_frame_and_cuts_reset(disc_clip: Clip) -> None:
    assert [bool(disc_clip[i].reset) for i in range(3)] == [True, False, False]
    assert [float(disc_clip[i].time) for i in range(3)] == [0, 1, 2]


def test_a_request_carries_only_its_time() -> None:
    frame = moment(2.5)
    assert not frame.is_shaded
    assert frame.size is None
    assert missing(frame, ("color", "depth", "time")) == ("color", "depth")


def test_an_unshaded_frame_keeps_its_buffers() -> None:
    frame = unshaded(disc_frame(1))
    assert not frame.is_shaded
    assert frame.depth is not None
    assert frame.size == (32, 48)


def test_frames_batch_and_tell_what_differs() -> None:
    both = concatenate([disc_frame(0), disc_frame(1)])
    assert both.color.shape == (2, 3, 32, 48)
    assert both.time.tolist() == [0, 1]
    with pytest.raises(ValueError, match="1 of 2 frames have no color"):
        concatenate([disc_frame(0), unshaded(disc_frame(1))])


def test_frames_are_pytrees_named_like_their_fields() -> None:
    leaves, spec = torch.utils._pytree.tree_flatten(disc_frame(1))
    again = torch.utils._pytree.tree_unflatten(leaves, spec)
    assert torch.equal(again.color, disc_frame(1).color)
    program = torch.export.export(_Mean(), (disc_frame(1),))
    names = [str(spec.arg.name) for spec in program.graph_signature.input_specs]
    assert "frame_color" in names
    assert "frame_motion_next" in names


class _Mean(torch.nn.Module):
    def forward(self, frame: Frame) -> torch.Tensor:
        return frame.color.mean() + frame.motion_next.mean()


def test_every_buffer_is_documented() -> None:
    from dataclasses import fields

    for f in fields(Frame):
        assert f.metadata["meaning"], f.name
        assert (f.name in BUFFERS) == bool(f.metadata["layers"])


@pytest.mark.parametrize(
    ("name", "shape"), [("color", (1, 2, 4, 4)), ("motion", (1, 3, 4, 4)), ("depth", (1, 4, 4)), ("jitter", (2,))]
)
def test_a_wrong_shape_is_refused_while_testing(name: str, shape: tuple[int, ...]) -> None:
    """The shape annotations are enforced here; without the hook this test fails."""
    good = {"jitter": torch.zeros(1, 2), "time": torch.zeros(1), "reset": torch.zeros(1) > 0, "span": torch.ones(1)}
    Frame(**good)
    with pytest.raises(Exception, match=r"(?i)type-check"):
        Frame(**{**good, name: torch.zeros(shape)})
    with pytest.raises(Exception, match=r"(?i)type-check"):
        warp(torch.zeros(1, 3, 4, 4), torch.zeros(1, 2, 5, 4))
