"""The renderer: buffers against geometry worked out by hand and by an independent ray tracer, light against known
energies."""

import os
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
import trimesh
from trimesh.ray.ray_pyembree import RayMeshIntersector

from framecast import clip, exr
from framecast.frame import SKY, Frame, camera_motion
from framecast.render import device, make, reference, shadows
from framecast.render.command import command
from framecast.render.geometry import shape, smooth_normals
from framecast.render.renderer import Renderer, changes
from framecast.render.scene import Camera, Instance, Light, LightPose, Material, Mesh, Mirror, Pose, Scene, Sky, Texture
from framecast.render.sky import split_sum
from framecast.render.view import view_of

try:
    device.open_device()
except FileNotFoundError as error:
    if os.environ.get("FRAMECAST_NEEDS_VULKAN"):
        raise
    pytest.skip(str(error), allow_module_level=True)

SIZE = (48, 64)
FOV = 0.9
UNIFORM = Sky(np.ones((8, 16, 3), np.float32), sun_disc=False)
DIM = Sky(np.full((8, 16, 3), 0.2, np.float32), sun_disc=False)
DARK = Sky(np.zeros((8, 16, 3), np.float32), sun_disc=False)


@pytest.fixture(autouse=True)
def _small_shadow_maps(monkeypatch) -> None:
    monkeypatch.setattr(shadows, "SUN_SIZE", 512)
    monkeypatch.setattr(shadows, "LAMP_SIZE", 256)


def moved(x: float, y: float, z: float) -> np.ndarray:
    matrix = np.eye(4)
    matrix[:3, 3] = x, y, z
    return matrix


def turned(axis: tuple[float, float, float], angle: float) -> np.ndarray:
    a = np.asarray(axis, float) / np.linalg.norm(axis)
    k = np.array([[0, -a[2], a[1]], [a[2], 0, -a[0]], [-a[1], a[0], 0]])
    matrix = np.eye(4)
    matrix[:3, :3] = np.eye(3) + np.sin(angle) * k + (1 - np.cos(angle)) * k @ k
    return matrix


def card(width: float, height: float, uv: float = 1.0) -> Mesh:
    """A rectangle in the xy-plane facing +z."""
    positions = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]) * [width / 2, height / 2, 1]
    uvs = np.array([[0.0, 1], [1, 1], [1, 0], [0, 0]]) * uv
    return Mesh(positions, np.tile([0.0, 0, 1], (4, 1)), uvs, np.array([0, 1, 2, 0, 2, 3]))


def ball(radius: float = 1.0, rings: int = 48) -> Mesh:
    polar, azimuth = np.meshgrid(
        np.linspace(0, np.pi, rings + 1), np.linspace(0, 2 * np.pi, 2 * rings + 1), indexing="ij"
    )
    points = np.stack([np.sin(polar) * np.sin(azimuth), np.cos(polar), np.sin(polar) * np.cos(azimuth)], -1).reshape(
        -1, 3
    )
    uvs = np.stack([azimuth / (2 * np.pi), polar / np.pi], -1).reshape(-1, 2)
    row = 2 * rings + 1
    first = (np.arange(rings)[:, None] * row + np.arange(2 * rings)).reshape(-1)
    corners = [first, first + row, first + row + 1, first, first + row + 1, first + 1]
    return Mesh(points * radius, points, uvs, np.stack(corners, 1).reshape(-1))


def world(*instances: Instance, camera: Callable[[float], np.ndarray], sky: Sky = UNIFORM, **parts) -> Scene:
    return Scene("test", instances, parts.pop("lights", ()), Camera(camera, FOV), sky, **parts)


def roaming(time: float) -> np.ndarray:
    """Walks, pans and rolls, accelerating."""
    position = moved(0.1 * time + 0.02 * time**2, 1.5 + 0.03 * time, 0.05 * time)
    return position @ turned((0, 1, 0), 0.03 * time) @ turned((1, 0, 0), -0.5) @ turned((0, 0, 1), 0.3 + 0.05 * time)


def floor_of(half: float = 40.0) -> Instance:
    return Instance(card(2 * half, 2 * half), Material(), pose=lambda time: Pose(turned((1, 0, 0), -np.pi / 2)))


def rays(camera: np.ndarray, jitter: tuple[float, float], fov: float = FOV) -> tuple[np.ndarray, np.ndarray]:
    """World directions, of length 1 along the camera's axis, through all samples; and the samples in pixels."""
    height, width = SIZE
    y, x = np.mgrid[0:height, 0:width] + 0.5
    x, y = x + jitter[0], y + jitter[1]
    tangent = np.tan(fov / 2)
    local = np.stack(
        [(2 * x / width - 1) * tangent * width / height, (1 - 2 * y / height) * tangent, -np.ones_like(x)], -1
    )
    return local @ camera[:3, :3].T, np.stack([x, y])


def seen_at(points: np.ndarray, camera: np.ndarray, fov: float = FOV) -> tuple[np.ndarray, np.ndarray]:
    """Pixel positions and depths of world points."""
    height, width = SIZE
    local = (points - camera[:3, 3]) @ camera[:3, :3]
    focal = height / 2 / np.tan(fov / 2)
    place = np.stack(
        [width / 2 - focal * local[..., 0] / local[..., 2], height / 2 + focal * local[..., 1] / local[..., 2]]
    )
    return place, -local[..., 2]


@pytest.mark.parametrize("jitter", [(0.0, 0.0), (0.35, -0.4)])
def test_plane_under_a_rolled_walking_camera(jitter):
    """Depth, normal and the three motions of a floor, at the jittered sample positions."""
    time = 3.0
    frame = Renderer(world(floor_of(), camera=roaming)).frame(time, SIZE, jitter)
    camera = roaming(time)
    directions, samples = rays(camera, jitter)
    depth = -camera[1, 3] / directions[..., 1]
    points = camera[:3, 3] + depth[..., None] * directions
    hit = (depth > 0) & (np.abs(points[..., [0, 2]]).max(-1) < 39)
    assert hit.mean() > 0.9
    np.testing.assert_allclose(frame["depth"][0][hit], depth[hit], rtol=1e-4)
    np.testing.assert_allclose(frame["normal"][:, hit], np.array([[0], [1], [0]]) * np.ones(hit.sum()), atol=1e-3)
    assert (frame["object"][0] == 0).all()
    for name, step in (("motion", -1), ("motion2", -2), ("motion_next", 1)):
        there, _ = seen_at(points, roaming(time + step))
        np.testing.assert_allclose(frame[name][:, hit], (there - samples)[:, hit], atol=3e-3)


def test_jitter_is_sample_minus_centre():
    """The opposite sign, or none, is far outside the tolerance of the plane test."""
    directions, _ = rays(roaming(3.0), (0.35, -0.4))
    frame = Renderer(world(floor_of(), camera=roaming)).frame(3.0, SIZE, (0.35, -0.4))
    for wrong in ((-0.35, -0.4), (0.35, 0.4), (0.0, 0.0)):
        other, _ = rays(roaming(3.0), wrong)
        depth = -roaming(3.0)[1, 3] / other[..., 1]
        near = (depth > 0) & (depth < 5)
        assert np.abs(frame["depth"][0][near] / depth[near] - 1).mean() > 20e-4
    assert directions.shape == (*SIZE, 3)


def test_sphere():
    """Depth and normal of a ball against the quadratic, its id, and nothing where there is nothing."""
    centre = np.array([0.3, -0.2, -4.0])
    one = Instance(ball(rings=96), Material(), object=7, pose=lambda time: Pose(moved(*centre)))
    frame = Renderer(world(one, camera=lambda time: np.eye(4))).frame(0.0, SIZE)
    directions, _ = rays(np.eye(4), (0.0, 0.0))
    a, b = (directions**2).sum(-1), directions @ centre
    root = b**2 - a * (centre @ centre - 1)
    depth = (b - np.sqrt(np.maximum(root, 0))) / a
    inside, outside = root > 0.3, root < -0.05
    normal = directions * depth[..., None] - centre
    np.testing.assert_allclose(frame["depth"][0][inside], depth[inside], rtol=1e-3)
    np.testing.assert_allclose(frame["normal"][:, inside], normal[inside].T, atol=0.01)
    assert (frame["object"][0][inside] == 7).all()
    assert (frame["object"][0][outside] == 0).all()
    assert (frame["depth"][0][outside] == SKY).all()
    assert (frame["normal"][:, outside] == 0).all()


def test_moving_disc_has_true_motion_and_the_rest_stands_still():
    """An accelerating card: motion2 is not twice motion, motion_next not its negative; still things move exactly 0."""
    place = lambda time: 0.05 * time + 0.02 * time**2  # noqa: E731
    mover = Instance(card(1, 1), Material(), object=3, pose=lambda time: Pose(moved(place(time), 0.1, -3)))
    wall = Instance(card(9, 3), Material(), pose=lambda time: Pose(moved(0, 0, -5)))
    frame = Renderer(world(mover, wall, camera=lambda time: np.eye(4))).frame(2.0, SIZE)
    focal = SIZE[0] / 2 / np.tan(FOV / 2) / 3
    on = frame["object"][0] == 3
    assert 50 < on.sum() < 500
    for name, step in (("motion", -1), ("motion2", -2), ("motion_next", 1)):
        expected = (place(2.0 + step) - place(2.0)) * focal
        np.testing.assert_allclose(frame[name][0][on], expected, atol=1e-3)
        np.testing.assert_allclose(frame[name][1][on], 0, atol=1e-3)
        assert (frame[name][:, ~on] == 0).all()
    assert (frame["depth"][0] == SKY).any()


def strip(joints: bool = True) -> Mesh:
    """A card of 8 segments along x from -1 to 1; x > 0 hangs on joint 1."""
    x = np.repeat(np.linspace(-1, 1, 9), 2)
    positions = np.stack([x, np.tile([-0.3, 0.3], 9), np.zeros(18)], 1)
    cells = np.arange(8)[:, None] * 2 + np.array([0, 2, 3, 0, 3, 1])
    number = np.stack([np.zeros(18), np.ones(18), np.zeros(18), np.zeros(18)], 1).astype(int)
    weights = np.stack([x <= 0, x > 0, x > 9, x > 9], 1).astype(float)
    normals = np.tile([0.0, 0, 1], (18, 1))
    return Mesh(positions, normals, positions[:, :2], cells.reshape(-1), joints=number, weights=weights)


def test_skinned_strip_swings_about_its_hinge():
    """Motion of skinned vertices is a rotation about the joint, from the true earlier poses."""
    angle = lambda time: 0.02 * time**2  # noqa: E731
    still = moved(0, 0, -3)
    pose = lambda time: Pose(np.eye(4), np.stack([still, still @ turned((0, 0, 1), angle(time))]))  # noqa: E731
    frame = Renderer(world(Instance(strip(), Material(), 1, pose), camera=lambda time: np.eye(4))).frame(3.0, SIZE)
    directions, samples = rays(np.eye(4), (0.0, 0.0))
    points = directions * 3
    arm = (frame["object"][0] == 1) & (points[..., 0] > 0.35)
    assert arm.sum() > 60
    for name, step in (("motion", -1), ("motion2", -2), ("motion_next", 1)):
        back = turned((0, 0, 1), angle(3.0 + step) - angle(3.0))[:3, :3]
        before, _ = seen_at((points + np.array([0, 0, 3])) @ back.T - [0, 0, 3], np.eye(4))
        np.testing.assert_allclose(frame[name][:, arm], (before - samples)[:, arm], atol=5e-3)
    hinge = (frame["object"][0] == 1) & (points[..., 0] < -0.05)
    assert (frame["motion"][:, hinge] == 0).all()


def test_morphed_card_moves_by_its_weights():
    flat = card(2, 2)
    mesh = replace(flat, morphs=np.tile([[[0.0, 0.4, 0.0]]], (1, 4, 1)))
    pose = lambda time: Pose(moved(0, 0, -4), morph_weights=np.array([0.1 * time**2]))  # noqa: E731
    frame = Renderer(world(Instance(mesh, Material(), 1, pose), camera=lambda time: np.eye(4))).frame(1.0, SIZE)
    focal = SIZE[0] / 2 / np.tan(FOV / 2) / 4
    on = frame["object"][0] == 1
    np.testing.assert_allclose(frame["motion"][1][on], 0.04 * focal, atol=1e-3)
    np.testing.assert_allclose(frame["motion2"][1][on], 0.0, atol=1e-3)
    np.testing.assert_allclose(frame["motion_next"][1][on], -0.12 * focal, atol=1e-3)


def framed(layers: dict, scene: Scene, time: float) -> Frame:
    view = view_of(scene.camera, time, SIZE[1] / SIZE[0])
    tensor = lambda m: torch.from_numpy(np.asarray(m, np.float32))[None]  # noqa: E731
    return Frame(
        depth=tensor(layers["depth"]), jitter=torch.zeros(1, 2), view=tensor(np.linalg.inv(view.camera)),
        projection=tensor(view.projection), time=torch.tensor([time]), reset=torch.tensor([False]), span=torch.ones(1),
    )  # fmt: skip


def test_matrices_and_depth_explain_the_motion_of_still_things_and_of_the_sky():
    """`frame.camera_motion`, written independently, agrees everywhere."""
    scene = world(floor_of(), camera=lambda time: roaming(time) @ turned((1, 0, 0), 0.5))
    renderer = Renderer(scene)
    now, before = renderer.frame(3.0, SIZE), renderer.frame(2.0, SIZE)
    expected = camera_motion(framed(now, scene, 3.0), framed(before, scene, 2.0))[0].numpy()
    sky = now["depth"][0] == SKY
    assert 0.1 < sky.mean() < 0.9
    near = now["depth"][0] < 30
    np.testing.assert_allclose(now["motion"][:, near], expected[:, near], atol=0.01)
    np.testing.assert_allclose(now["motion"][:, sky], expected[:, sky], atol=0.02)


def test_buffers_hold_what_the_material_says():
    pixels = np.full((4, 4, 4), 255, np.uint8)
    pixels[..., :3] = 188
    surface = Material((0.5, 1, 1, 1), Texture(pixels, srgb=True), roughness=0.3, metallic=0.6, emissive=(2, 0, 0))
    wall = Instance(card(20, 20), surface, pose=lambda time: Pose(moved(0, 0, -3)))
    frame = Renderer(world(wall, camera=lambda time: np.eye(4), sky=DARK, exposure=lambda time: 1.5)).frame(0.0, SIZE)
    linear = ((188 / 255 + 0.055) / 1.055) ** 2.4
    np.testing.assert_allclose(frame["albedo"].mean((1, 2)), [linear / 2, linear, linear], rtol=4e-3)
    np.testing.assert_allclose(frame["roughness"], 0.3, atol=1e-3)
    np.testing.assert_allclose(frame["metallic"], 0.6, atol=1e-3)
    np.testing.assert_allclose(frame["color"].mean((1, 2)), [3, 0, 0], atol=2e-3)


def test_normal_maps_bend_towards_plus_u_and_up():
    """Red leans along growing u, green up the image, whatever way the surface faces."""
    pixels = np.zeros((2, 2, 4), np.uint8)
    pixels[:] = np.round(np.array([0.5 + 0.3, 0.5 + 0.2, 0.5 + np.sqrt(0.25 - 0.13), 1]) * 255)
    wall = Instance(card(20, 20), Material(normal_texture=Texture(pixels)), pose=lambda time: Pose(moved(0, 0, -3)))
    frame = Renderer(world(wall, camera=lambda time: np.eye(4))).frame(0.0, SIZE)
    np.testing.assert_allclose(frame["normal"].mean((1, 2)), [0.6, 0.4, np.sqrt(0.48)], atol=0.01)


def test_alpha_mask_cuts_holes_in_every_buffer():
    pixels = np.full((2, 2, 4), 255, np.uint8)
    pixels[:, 0, 3] = 0
    leaf = Material(base_texture=Texture(pixels, repeat=False), alpha_mode="mask")
    one = Instance(card(2, 2), leaf, object=5, pose=lambda time: Pose(moved(0, 0, -2)))
    frame = Renderer(world(one, camera=lambda time: np.eye(4))).frame(0.0, SIZE)
    middle, quarter = SIZE[0] // 2, SIZE[1] // 4
    assert frame["object"][0, middle, SIZE[1] // 2 + 8] == 5
    assert frame["depth"][0, middle, SIZE[1] // 2 + 8] < SKY
    assert frame["object"][0, middle, quarter + 4] == 0
    assert frame["depth"][0, middle, quarter + 4] == SKY


@pytest.mark.parametrize("roughness", [0.0, 0.3, 0.7, 1.0])
def test_white_furnace(roughness):
    """A lossless metal under a uniform sky is as bright as the sky: no energy is lost or made, at any roughness."""
    one = Instance(ball(), Material(roughness=roughness, metallic=1.0), pose=lambda time: Pose(moved(0, 0, -4)))
    frame = Renderer(world(one, camera=lambda time: np.eye(4))).frame(0.0, SIZE)
    on = frame["depth"][0] < SKY
    np.testing.assert_allclose(frame["color"][:, on], 1.0, atol=0.03)


def test_split_sum_limits():
    """A perfect mirror reflects f0 + (1 - f0) (1 - n.v)^5 of a uniform sky."""
    table = split_sum()
    facing = np.linspace(0, 1, 64)[8:]
    np.testing.assert_allclose(table[0, 8:, 0], 1 - (1 - facing) ** 5, atol=5e-3)
    np.testing.assert_allclose(table[0, 8:, 1], (1 - facing) ** 5, atol=5e-3)
    assert (table.sum(-1) <= 1 + 1e-6).all()
    assert (table.sum(-1)[:6, 24:] > 0.97).all()


def sun(direction: tuple[float, float, float], **parts) -> Light:
    unit = np.asarray(direction, float) / np.linalg.norm(direction)
    return Light("sun", (1, 1, 1), np.pi, lambda time: LightPose(np.zeros(3), unit), **parts)


def looking_down(time: float) -> np.ndarray:
    return moved(0, 6, 0) @ turned((1, 0, 0), -np.pi / 2)


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


def busy(time_of_day: Callable[[float], tuple] = lambda time: (0.4, -1, -0.3)) -> Scene:
    """Something of everything, small."""
    leaf = np.full((8, 8, 4), 255, np.uint8)
    leaf[::2, :, 3] = 0
    stripes = np.full((16, 16, 4), 255, np.uint8)
    stripes[:, ::4, :3] = 40
    light = Light("sun", (1, 0.9, 0.8), 3, lambda t: LightPose(np.zeros(3), np.asarray(time_of_day(t), float)), 0.02)
    ground = Material(base_texture=Texture(stripes, True))
    leaves = Material(base_texture=Texture(leaf, True), alpha_mode="mask", double_sided=True)
    parts = (
        Instance(card(12, 12, 6), ground, pose=lambda t: Pose(turned((1, 0, 0), -np.pi / 2))),
        Instance(
            ball(0.7, 24), Material((0.8, 0.3, 0.2, 1), roughness=0.9), 1, lambda t: Pose(moved(0.1 * t, 0.7, -3))
        ),
        Instance(card(1, 1), leaves, 2, lambda t: Pose(moved(1.5, 0.6, -2.5) @ turned((0, 1, 0), 0.2 * t))),
    )
    return world(*parts, sky=DIM, lights=(light,),
                 camera=lambda t: moved(0.05 * t, 1.2, 1) @ turned((1, 0, 0), -0.25))  # fmt: skip


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


def test_jitter_sequence():
    """Halton(2, 3), 8 scale^2 phases, well spread around the centre."""
    assert [reference.phases(s) for s in (1, 1.5, 1.7, 2, 3)] == [8, 18, 24, 32, 72]
    points = np.array([reference.jitter(k, 32) for k in range(32)])
    np.testing.assert_allclose(points[:3], [[0, -1 / 6], [-0.25, 1 / 6], [0.25, -7 / 18]], atol=1e-12)
    assert np.abs(points).max() < 0.5
    assert np.abs(points.mean(0)).max() < 0.04
    assert reference.jitter(33, 32) == reference.jitter(1, 32)


def corners(scene: Scene, time: float) -> np.ndarray:
    """All triangles of a scene in world space, in the order of its instances: t 3 3."""
    parts = []
    for one in scene.instances:
        pose = one.pose(time)
        points = shape(one.mesh, pose).positions @ pose.matrix[:3, :3].T + pose.matrix[:3, 3]
        parts.append(points[one.mesh.indices].reshape(-1, 3, 3))
    return np.concatenate(parts)


def assert_oracle_agrees(scene: Scene, time: float, jitter: tuple[float, float]) -> None:
    """Visibility, depth and motion against rays that Embree traces through the scene's triangles."""
    frame = Renderer(scene).frame(time, SIZE, jitter)
    now, camera = corners(scene, time), scene.camera.at(time)
    directions, samples = rays(camera, jitter, scene.camera.vertical_fov)
    mesh = trimesh.Trimesh(now.reshape(-1, 3), np.arange(len(now) * 3).reshape(-1, 3), process=False)
    origins = np.tile(camera[:3, 3], (samples[0].size, 1))
    hits, ray, triangle = RayMeshIntersector(mesh).intersects_location(
        origins, directions.reshape(-1, 3), multiple_hits=False
    )
    seen = np.zeros(SIZE[0] * SIZE[1], bool)
    seen[ray] = True
    drawn = frame["depth"].reshape(-1) < SKY
    assert seen.sum() > 100
    assert (seen != drawn).sum() <= 4
    keep = drawn[ray]
    hits, ray, triangle = hits[keep], ray[keep], triangle[keep]
    _, depth = seen_at(hits, camera, scene.camera.vertical_fov)
    error = np.abs(frame["depth"].reshape(-1)[ray] / depth - 1)
    assert np.quantile(error, 0.97) < 2e-3
    weights = trimesh.triangles.points_to_barycentric(now[triangle], hits)
    for name, step in (("motion", -1), ("motion2", -2), ("motion_next", 1)):
        there = np.einsum("nk,nkc->nc", weights, corners(scene, time + step)[triangle])
        place, _ = seen_at(there, scene.camera.at(time + step), scene.camera.vertical_fov)
        expected = place - samples.reshape(2, -1)[:, ray]
        assert np.quantile(np.abs(frame[name].reshape(2, -1)[:, ray] - expected).max(0), 0.95) < 0.02


def test_oracle_agrees_on_things_that_turn_bend_and_swell():
    """A rigid torus, a skinned strip bent by blended weights and a morphed ball, under a rolling camera."""
    torus = trimesh.creation.torus(0.8, 0.35, major_sections=40, minor_sections=20)
    points, faces = np.asarray(torus.vertices), np.asarray(torus.faces).reshape(-1)
    knot = Mesh(points, smooth_normals(points, faces), points[:, :2], faces)
    bent = strip()
    along = np.clip(bent.positions[:, 0] / 2 + 0.5, 0, 1)
    bent = replace(bent, weights=np.stack([1 - along, along, 0 * along, 0 * along], 1))
    round_ = ball(0.5, 16)
    swelling = replace(round_, morphs=round_.positions[None] * [0.5, 1.0, 0.2])
    still, two_sided = moved(0.3, 0.9, -2.8), Material(double_sided=True)
    joints = lambda time: np.stack([still, still @ turned((0, 1, 1), 0.2 * time)])  # noqa: E731
    parts = (
        Instance(knot, Material(), 1, lambda t: Pose(moved(0.2, -0.3, -3) @ turned((1, 2, 0.5), 0.15 * t))),
        Instance(bent, two_sided, 2, lambda t: Pose(np.eye(4), joints(t))),
        Instance(swelling, Material(), 3, lambda t: Pose(moved(-1, 0.9, -3), morph_weights=np.array([0.1 * t * t]))),
    )
    camera = lambda time: moved(0.05 * time, 0, 0) @ turned((0, 0, 1), 0.04 * time**2)  # noqa: E731
    assert_oracle_agrees(world(*parts, camera=camera), 2.0, (-0.3, 0.45))


def test_oracle_agrees_on_a_gltf_file(tmp_path: Path):
    """A file without camera, through the loader: nodes nested, moved, turned and mirrored; the camera orbits."""
    content = trimesh.Scene()
    content.add_geometry(trimesh.creation.torus(0.8, 0.3), transform=moved(0.4, 1, 0) @ turned((1, 1, 0), 0.7))
    content.add_geometry(trimesh.creation.icosphere(3, 0.6), transform=moved(-0.8, 0.6, 0.3) @ np.diag([-1.0, 1, 2, 1]))
    path = tmp_path / "things.glb"
    path.write_bytes(content.export(file_type="glb"))
    assert_oracle_agrees(make.load(str(path)), 5.0, (0.2, -0.1))


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
    np.testing.assert_allclose(made[1].jitter[0].numpy(), reference.jitter(1, 18), atol=1e-6)
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
