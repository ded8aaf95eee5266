"""The renderer's light against known energies, its references, and its clips on disk."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from analytic import (
    DARK,
    FOV,
    SIZE,
    busy,
    card,
    floor_of,
    looking_down,
    moved,
    rays,
    seen_at,
    sun,
    turned,
    world,
)

from framecast import clip, exr, resample
from framecast.render import device, make, reference
from framecast.render.command import command
from framecast.render.renderer import Renderer, changes
from framecast.render.scene import Instance, Light, LightPose, Material, Mirror, Pose

pytestmark = pytest.mark.usefixtures("small_shadow_maps")


def test_a_sun_lights_by_its_cosine_and_casts_shadows():
    """A white floor under a sun of irradiance pi: radiance is the cosine, less what the coat reflects; 0 in the
    shadow."""
    lid = Instance(
        card(2, 2), Material(), object=1, pose=lambda time: Pose(moved(0, 1, 0) @ turned((1, 0, 0), -np.pi / 2))
    )
    slanted = sun((0.5, -np.sqrt(0.75), 0))
    scene = world(floor_of(), lid, camera=looking_down, sky=DARK, lights=(slanted,), occlusion_radius=0.01)
    frame = Renderer(scene).frame(0.0, SIZE)
    points = rays(looking_down(0.0), (0, 0))[0] * frame["depth"][0][..., None] + [0, 6, 0]
    x, z = points[..., 0] - 0.5 / np.sqrt(0.75), points[..., 2]
    floor = frame["object"][0] == 0
    dark = floor & (np.abs(x) < 0.85) & (np.abs(z) < 0.85)
    lit = floor & ((np.abs(x) > 1.15) | (np.abs(z) > 1.15))
    assert dark.sum() > 20
    assert (frame["color"][:, dark] == 0).all()
    np.testing.assert_allclose(frame["color"][:, lit], np.sqrt(0.75), rtol=0.06)


@pytest.mark.parametrize("kind", ["point", "spot"])
def test_lamps_fall_off_and_cast_shadows(kind):
    """Irradiance is intensity / distance^2 times the cosine; a spot ends at its cone; a lid casts a shadow."""
    lamp = Light(
        kind, (1, 1, 1), 4 * np.pi, lambda time: LightPose(np.array([0, 2.0, 0]), np.array([0, -1.0, 0])),
        inner_cone=0.8, outer_cone=0.85, reach=1000.0,
    )  # fmt: skip
    lid = Instance(
        card(0.5, 0.5), Material(), object=1, pose=lambda time: Pose(moved(1, 1, 0) @ turned((1, 0, 0), -np.pi / 2))
    )
    scene = world(floor_of(), lid, camera=looking_down, sky=DARK, lights=(lamp,), occlusion_radius=0.01)
    frame = Renderer(scene).frame(0.0, SIZE)
    points = rays(looking_down(0.0), (0, 0))[0] * frame["depth"][0][..., None] + [0, 6, 0]
    radius2 = points[..., 0] ** 2 + points[..., 2] ** 2
    shadow = np.maximum(np.abs(points[..., 0] - 2), np.abs(points[..., 2]))
    floor = (frame["object"][0] == 0) & (points[..., 0] < 0.9)
    inner = floor & (radius2 < 1.5**2)
    expected = 4 * 2 / (radius2 + 4) ** 1.5
    np.testing.assert_allclose(frame["color"][0][inner], expected[inner], rtol=0.08)
    assert (frame["color"][0][(shadow < 0.35) & (frame["object"][0] == 0)] == 0).all()
    outer = floor & (radius2 > 2.4**2)
    assert (frame["color"][0][outer] == 0).all() if kind == "spot" else (frame["color"][0][outer] > 0).all()


def test_a_mirror_shows_the_reflected_world():
    """A glowing card above a perfect mirror on the floor appears where its mirror image stands."""
    glow = Instance(card(1, 1), Material((0, 0, 0, 1), emissive=(3, 0, 0), double_sided=True), 1,
                    pose=lambda time: Pose(moved(0, 1.5, -4)))  # fmt: skip
    glass = Instance(card(40, 40), Material(metallic=1.0, roughness=0.0), mirror=0,
                     pose=lambda time: Pose(turned((1, 0, 0), -np.pi / 2)))  # fmt: skip
    camera = lambda time: moved(0, 1, 0) @ turned((1, 0, 0), -0.3)  # noqa: E731
    plane = Mirror(np.zeros(3), np.array([0.0, 1, 0]))
    frame = Renderer(world(glow, glass, camera=camera, sky=DARK, mirrors=(plane,))).frame(0.0, SIZE)
    inside, _ = seen_at(
        np.array([[-0.4, -1.9, -4], [0.4, -1.9, -4], [0, -1.5, -4], [-0.4, -1.1, -4], [0.4, -1.1, -4]]), camera(0)
    )
    outside, _ = seen_at(np.array([[-0.7, -1.5, -4], [0.7, -1.5, -4], [0, -2.2, -4]]), camera(0))
    at = lambda places: frame["color"][0][places[1].astype(int), places[0].astype(int)]  # noqa: E731
    np.testing.assert_allclose(at(inside), 3, rtol=0.02)
    np.testing.assert_allclose(at(outside), 0, atol=1e-3)


def test_a_frame_depends_on_nothing_but_its_arguments():
    """Bit for bit the same from a fresh renderer and from one that has drawn other times, jitters and sizes before."""
    used = Renderer(busy(lambda t: (0.4 + 0.1 * t, -1, 0)))
    used.frame(1.0, SIZE, (0.2, 0.1), -1.0)
    used.frame(4.0, (24, 32))
    changes(used, 3.0, SIZE)
    fresh = Renderer(busy(lambda t: (0.4 + 0.1 * t, -1, 0)))
    one, two = used.frame(2.0, SIZE, (0.1, 0.3), -1.0), fresh.frame(2.0, SIZE, (0.1, 0.3), -1.0)
    assert all(np.array_equal(one[name], two[name]) for name in one)


def test_shading_of_still_light_does_not_move_and_moving_light_is_found():
    """Diffuse things under a fixed sun keep their colour while the camera and things move; a moving sun marks the
    shadow."""
    still = changes(Renderer(busy()), 2.0, SIZE)
    mild = still.shading[0][~still.disoccluded[0]]
    assert np.quantile(mild, 0.9) < 0.01
    moving = changes(Renderer(busy(lambda t: (0.4 + 0.2 * t, -1, -0.3))), 2.0, SIZE)
    assert (moving.shading > 0.1).mean() > 0.01 > (still.shading > 0.1).mean()


def test_unmoved_scene_has_no_shading_change_at_all():
    scene = world(
        *busy().instances[:1], camera=lambda t: moved(0.1 * t, 1.2, 1) @ turned((1, 0, 0), -0.25), lights=busy().lights
    )
    found = changes(Renderer(scene), 2.0, SIZE)
    assert found.shading.max() < 2e-3
    assert found.disoccluded.mean() < 0.05


def warped(image: np.ndarray, motion: np.ndarray) -> np.ndarray:
    """Bilinear look-up at position + motion."""
    height, width = image.shape[1:]
    y, x = np.mgrid[0:height, 0:width] + motion[::-1]
    x, y = np.clip(x, 0, width - 1), np.clip(y, 0, height - 1)
    i, j = np.minimum(x.astype(int), width - 2), np.minimum(y.astype(int), height - 2)
    u, v = x - i, y - j
    top, bottom = (image[:, j + k, i] * (1 - u) + image[:, j + k, i + 1] * u for k in (0, 1))
    return top * (1 - v) + bottom * v


def test_true_motion_predicts_the_reference_except_where_shading_moves():
    scene = busy(lambda t: (0.4 + 0.2 * t, -1, -0.3))
    renderer = Renderer(scene)
    before, now = (reference.reference(renderer, t, (96, 128), 8).color for t in (2.0, 3.0))
    found = changes(renderer, 3.0, (96, 128))
    seen = ~found.disoccluded[0]
    error = lambda a, where: float(((a - now)[:, where] ** 2).mean())  # noqa: E731
    calm, moving = seen & (found.shading[0] < 0.02), seen & (found.shading[0] > 0.1)
    assert calm.mean() > 0.5
    assert moving.mean() > 0.005
    guess = warped(before, found.motion)
    assert error(guess, calm) < 0.3 * error(before, calm)
    assert error(guess, moving) > 20 * error(guess, calm)


def test_reference_of_an_edge_is_its_coverage():
    """A black card over a glowing wall covers a third of a pixel column: the mean of c / (1 + c) tells."""
    wall = Instance(card(30, 30), Material((0, 0, 0, 1), emissive=(1, 1, 1)), pose=lambda time: Pose(moved(0, 0, -9)))
    unit = 2 * np.tan(FOV / 2) / SIZE[0]
    black = Instance(
        card(2, 2), Material((0, 0, 0, 1), roughness=1.0), 1, pose=lambda time: Pose(moved(-1 + unit * 4 / 3, 0, -1))
    )
    made = reference.reference(
        Renderer(world(wall, black, camera=lambda time: np.eye(4), sky=DARK)), 0.0, SIZE, 64, ranges=True
    )
    row = made.color[0, SIZE[0] // 2]
    middle = SIZE[1] // 2
    np.testing.assert_allclose(row[[middle, middle + 2]], [0, 1], atol=2e-3)
    np.testing.assert_allclose(row[middle + 1] / (1 + row[middle + 1]), 2 / 3 / 2, atol=0.02)
    low, high = made.ranges[[0, 6]], made.ranges[[3, 7]]
    np.testing.assert_allclose(low[:, SIZE[0] // 2, middle + 1], [0, 1], atol=2e-3)
    np.testing.assert_allclose(high[:, SIZE[0] // 2, middle + 1], [1, 9], atol=2e-3)
    np.testing.assert_allclose(made.ranges[8:], 0, atol=1e-4)


@pytest.fixture
def small(monkeypatch) -> make.Settings:
    monkeypatch.setattr(make, "load", lambda source, seed: replace(busy(), cuts=frozenset({2})))
    return make.Settings("busy", size=(24, 32), scale=1.5, samples=4, ranges=True)


def test_clip_on_disk(small, tmp_path: Path):
    """What a reader finds: frames that pass the clip's checks, jitter, cuts, references and masks at display size."""
    made = make.render_clip(small, tmp_path / "clip", frames=3, preview=True)
    assert len(made) == 3
    assert made.scale == 1.5
    assert made.span == 1.0
    assert made.provenance["adapter"] == device.adapter_name()
    assert made[2].reset.item()
    assert not made[1].reset.item()
    np.testing.assert_allclose(made[1].jitter[0].numpy(), resample.jitter(1, 18), atol=1e-6)
    assert made[1].normal is not None
    assert made[1].motion_next is not None
    assert made[1].object is not None
    assert made.reference(1).shape == (1, 3, 36, 48)
    masks = exr.read(tmp_path / "clip/masks/0001.exr")
    assert set(masks.channels) == set(make.MASKS)
    assert masks.size == (36, 48)
    assert exr.read(tmp_path / "clip/masks/0002.exr").channels["disoccluded.Y"].min() == 1
    assert set(exr.read(tmp_path / "clip/ranges/0001.exr").channels) == set(reference.RANGES)
    assert (tmp_path / "clip/preview.png").stat().st_size > 1000


def test_the_same_clip_twice_is_the_same_bytes_and_a_stopped_one_goes_on(small, tmp_path: Path):
    make.render_clip(small, tmp_path / "a", frames=2)
    make.render_clip(small, tmp_path / "b", frames=1)
    first = tmp_path / "b/frames/0000.exr"
    stamp = first.stat().st_mtime_ns
    make.render_clip(small, tmp_path / "b", frames=2)
    assert first.stat().st_mtime_ns == stamp
    files = sorted(path.relative_to(tmp_path / "a") for path in (tmp_path / "a").rglob("*.*"))
    assert len(files) == 2 * 4 + 1
    assert all((tmp_path / "a" / name).read_bytes() == (tmp_path / "b" / name).read_bytes() for name in files)


def test_a_folder_of_another_render_is_not_mixed(small, tmp_path: Path):
    make.render_clip(small, tmp_path, frames=1)
    with pytest.raises(clip.ClipError, match="another render"):
        make.render_clip(replace(small, seed=1), tmp_path, frames=2)


def test_errors_are_sentences(monkeypatch, tmp_path: Path):
    with pytest.raises(ValueError, match="there is no scene 'nowhere'"):
        make.load("nowhere")
    with pytest.raises(ValueError, match="sizes start at 8x8"):
        make._check(make.Settings("x", size=(4, 4)), tmp_path, 1)
    import wgpu

    monkeypatch.setattr(wgpu.gpu, "enumerate_adapters_sync", list)
    with pytest.raises(FileNotFoundError, match="apt install mesa-vulkan-drivers"):
        device.open_device.__wrapped__()


def test_command_lists_scenes_and_reads_sizes(capsys, small, tmp_path: Path):
    command(list=True)
    assert "courtyard" in capsys.readouterr().out
    command("busy", tmp_path / "clip", size="32x24", scale=1.0, frames=1, samples=0)
    assert "1 frame, 32x24" in capsys.readouterr().out
    with pytest.raises(ValueError, match="size is WIDTHxHEIGHT"):
        command("busy", tmp_path / "other", size="wide")
    with pytest.raises(ValueError, match="name a scene"):
        command()


def test_split_of_the_list_is_that_of_the_scenes():
    for name, split, _ in make.listing()[::5]:
        assert make.load(name).split == split


def test_web_limits():
    """No shader may need more than a browser grants."""
    limits = device.open_device().limits
    assert all(limits[name] == value for name, value in device.LIMITS.items())
