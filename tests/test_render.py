"""The renderer's buffers against geometry worked out by hand and by an independent ray tracer."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
from analytic import (
    DARK,
    FOV,
    SIZE,
    ball,
    card,
    floor_of,
    framed,
    moved,
    rays,
    roaming,
    seen_at,
    turned,
    world,
)
from trimesh.ray.ray_pyembree import RayMeshIntersector

from framecast.frame import SKY, camera_motion
from framecast.render import make
from framecast.render.geometry import shape, smooth_normals
from framecast.render.renderer import Renderer
from framecast.render.scene import Instance, Material, Mesh, Pose, Scene, Texture
from framecast.render.sky import split_sum

pytestmark = pytest.mark.usefixtures("small_shadow_maps")


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
