"""The scenes in code: sound data, honest motion, and a split that shares no shape and no texture."""

import ast
import functools
import hashlib
import itertools
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from framecast.render import mesh as meshes
from framecast.render.finish import relief
from framecast.render.geometry import shape
from framecast.render.heldout_hangar import HIP, LEGS, LOWER, UPPER, robot_joints
from framecast.render.heldout_shapes import block, loft, pillow
from framecast.render.heldout_textures import cells, spectral
from framecast.render.motion import aim, along, move, scale, turn
from framecast.render.scene import Instance, Mesh, Scene
from framecast.render.scenes import SCENES, TEST, TRAIN
from framecast.render.skies import directions, dome, sun_travel
from framecast.render.train_character import JOINTS, ORDER, walk_joints
from framecast.render.train_shapes import ball, box, tube
from framecast.render.train_textures import clouds, lattice_noise

FOLDER = Path(meshes.__file__).parent
KINDS = {"Mesh", "Material", "Texture", "list[Instance]"}
SHARED = {"mesh", "motion", "finish", "skies", "scene"}
"""Modules that scenes of both splits may call: array maths, no shape and no pattern of their own (docs/scenes.md)."""


@functools.cache
def built(name: str) -> Scene:
    return SCENES[name](1)


def reached(module: str) -> set[str]:
    """The module, and all modules of this package that its functions can call, however far down."""
    found, waiting = set(), [module]
    while waiting:
        name = waiting.pop()
        if name not in found:
            found.add(name)
            nodes = ast.walk(ast.parse((FOLDER / f"{name}.py").read_text()))
            imports = [node.module or "" for node in nodes if isinstance(node, ast.ImportFrom)]
            waiting += [i.removeprefix("framecast.render.") for i in imports if i.startswith("framecast.render.")]
    return found


def moved(one: Instance, time: float) -> np.ndarray:
    """Vertices of an instance in the world."""
    pose = one.pose(time)
    return shape(one.mesh, pose).positions.astype(float) @ pose.matrix[:3, :3].T + pose.matrix[:3, 3]


def volume(mesh: Mesh) -> float:
    """Signed volume of a closed mesh; positive if its triangles face outwards."""
    p = mesh.positions[mesh.indices.reshape(-1, 3)].astype(np.float64)
    return float(np.einsum("nc,nc->n", p[:, 0], np.cross(p[:, 1], p[:, 2])).sum() / 6)


each = pytest.mark.parametrize("name", SCENES)


def test_training_and_held_out_scenes_share_no_shape_and_no_texture_function() -> None:
    """Nothing that a training scene can call is within reach of a held-out one, the shared array maths apart."""
    made: dict[str, set[str]] = {"train": set(), "test": set()}
    for name, function in SCENES.items():
        made[built(name).split] |= reached(function.__module__.removeprefix("framecast.render.")) - SHARED
    assert not made["train"] & made["test"]
    assert {"train_shapes", "train_textures"} <= made["train"]
    assert {"heldout_shapes", "heldout_textures"} <= made["test"]


def test_the_shared_modules_make_no_mesh_and_no_material_from_nothing() -> None:
    """Each of their functions that returns one is given its points or pixels: shapes and patterns come from outside."""
    given = {"standing", "shaded", "from_grid", "join", "placed", "scattered", "box_uvs", "textured", "plain", "image"}
    makers = set()
    for module in SHARED - {"scene"}:
        for node in ast.parse((FOLDER / f"{module}.py").read_text()).body:
            if isinstance(node, ast.FunctionDef) and ast.unparse(node.returns or ast.Constant(None)) in KINDS:
                makers.add(node.name)
    assert makers <= given


def test_no_texture_image_and_no_mesh_occurs_in_both_splits() -> None:
    seen: dict[str, set[bytes]] = {"train": set(), "test": set()}
    for name in SCENES:
        for one in built(name).instances:
            arrays = [one.mesh.positions]
            if one.material.base_texture is not None:
                arrays.append(one.material.base_texture.pixels)
            seen[built(name).split] |= {hashlib.sha256(a.tobytes()).digest() for a in arrays if a.size > 12}
    assert not seen["train"] & seen["test"]


def test_there_are_six_training_and_four_held_out_scenes_and_both_hold_what_breaks_methods() -> None:
    """Skins, shape keys, leaves, mirrors, moving lamps and suns, cuts: in both splits, to be trained and tested."""
    scenes = [built(name) for name in SCENES]
    assert tuple(scene.name for scene in scenes if scene.split == "train") == TRAIN
    assert tuple(scene.name for scene in scenes if scene.split == "test") == TEST
    assert sum(scene.split == "train" for scene in scenes) >= 6
    assert sum(scene.split == "test" for scene in scenes) >= 4
    for split in ("train", "test"):
        own = [scene for scene in scenes if scene.split == split]
        instances = [one for scene in own for one in scene.instances]
        lights = [light for scene in own for light in scene.lights if light.casts_shadow]
        assert any(one.mesh.joints is not None for one in instances)
        assert any(one.mesh.morphs is not None for one in instances)
        assert any(one.material.alpha_mode == "mask" for one in instances)
        assert any(max(one.material.emissive) > 4 for one in instances)
        assert any(one.material.metallic == 1.0 and one.material.roughness < 0.3 for one in instances)
        assert any(scene.mirrors for scene in own)
        assert any(scene.cuts for scene in own)
        assert any(light.kind == "sun" and (light.at(0).direction != light.at(9).direction).any() for light in lights)
        assert any(light.kind == "spot" and (light.at(0).direction != light.at(9).direction).any() for light in lights)
    assert any((scene.camera.at(0) == scene.camera.at(30)).all() for scene in scenes)


@each
def test_meshes_are_finite_whole_and_of_a_size_that_a_software_driver_can_draw(name: str) -> None:
    scene = built(name)
    assert 10_000 < sum(len(one.mesh.indices) // 3 for one in scene.instances) < 160_000
    for mesh in {id(one.mesh): one.mesh for one in scene.instances}.values():
        assert np.isfinite(mesh.positions).all()
        assert np.isfinite(mesh.uvs).all()
        np.testing.assert_allclose(np.linalg.norm(mesh.normals, axis=1), 1, atol=1e-3)
        assert mesh.indices.min() >= 0
        assert mesh.indices.max() < len(mesh.positions)
        if mesh.weights is not None:
            np.testing.assert_allclose(mesh.weights.sum(axis=1), 1, atol=1e-5)


@each
def test_solid_things_show_their_front(name: str) -> None:
    """Triangles of one-sided materials turn counter-clockwise seen from where their normals point."""
    for one in built(name).instances:
        if not one.material.double_sided:
            p, n = (
                one.mesh.positions[one.mesh.indices.reshape(-1, 3)],
                one.mesh.normals[one.mesh.indices.reshape(-1, 3)],
            )
            facing = np.einsum("nc,nc->n", np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]), n.sum(axis=1))
            assert (facing > 0).mean() > 0.99


@each
def test_objects_are_numbered_by_what_moves(name: str) -> None:
    """Number 0 stands still; every other number moves between two frames, and gives the same pose for the same time."""
    scene = built(name)
    stirred: dict[int, bool] = {}
    for one in scene.instances:
        assert 0 <= one.object <= 2047
        before, after = moved(one, 7.0), moved(one, 8.0)
        np.testing.assert_array_equal(before, moved(one, 7.0))
        assert np.isfinite(moved(one, -2.0)).all()
        assert np.isfinite(moved(one, 71.5)).all()
        stirred[one.object] = stirred.get(one.object, False) or bool(np.abs(before - after).max() > 1e-7)
    assert not stirred.pop(0)
    assert all(stirred.values()), [number for number, moves in stirred.items() if not moves]


@each
def test_the_camera_is_rigid_and_jumps_only_at_cuts(name: str) -> None:
    scene = built(name)
    views = [scene.camera.at(float(t)) for t in range(scene.frames)]
    for k, (a, b) in enumerate(itertools.pairwise(views), start=1):
        np.testing.assert_allclose(b[:3, :3].T @ b[:3, :3], np.eye(3), atol=1e-9)
        turned = np.degrees(np.arccos(np.clip((np.trace(a[:3, :3].T @ b[:3, :3]) - 1) / 2, -1, 1)))
        jumps = bool(turned > 5 or np.linalg.norm(b[:3, 3] - a[:3, 3]) > 0.3)
        assert jumps == (k in scene.cuts), k
    assert scene.exposure(0.0) > 0


@pytest.mark.parametrize("name", ["hangar", "clockwork"])
def test_a_seed_is_a_variant_and_the_same_seed_the_same_scene(name: str) -> None:
    one, again, other = built(name), SCENES[name](1), SCENES[name](2)
    for a, b in zip(one.instances, again.instances, strict=True):
        np.testing.assert_array_equal(moved(a, 3.5), moved(b, 3.5))
        if a.material.base_texture is not None:
            assert b.material.base_texture is not None
            np.testing.assert_array_equal(a.material.base_texture.pixels, b.material.base_texture.pixels)
    pairs = [(a, b) for a, b in zip(one.instances, other.instances, strict=False) if a.object and a.object == b.object]
    assert any(
        len(a.mesh.positions) != len(b.mesh.positions) or np.abs(moved(a, 0) - moved(b, 0)).max() > 0.01
        for a, b in pairs
    )


def test_walking_feet_stand_and_bones_keep_their_length() -> None:
    """While a foot stands, its ankle stays within 3 cm of one spot on the ground though the body walks 0.5 m."""
    ankle = np.array([*JOINTS["foot_left"][1], 1])
    walked = np.linspace(0, 1.1 * 0.42, 12)
    spots = [(walk_joints(float(d))[ORDER.index("foot_left")] @ ankle)[:3] + np.array([0, 0, d]) for d in walked]
    assert np.ptp(spots, axis=0).max() < 0.03
    for joint in walk_joints(0.37):
        np.testing.assert_allclose(joint[:3, :3].T @ joint[:3, :3], np.eye(3), atol=1e-12)
    np.testing.assert_allclose(walk_joints(0.2), walk_joints(0.2 + 1.1), atol=1e-9)


def test_the_robot_stands_on_feet_that_do_not_slide() -> None:
    x, z = LEGS[0]
    foot = np.array([x, HIP - UPPER - LOWER, z, 1])
    spots = [(robot_joints(float(d))[2] @ foot)[:3] + np.array([d, 0, 0]) for d in np.linspace(0.01, 0.9 * 0.54, 9)]
    assert np.ptp(spots, axis=0).max() < 0.01


def test_meshing_gears_have_one_speed_at_the_pitch_circle() -> None:
    gears = [one for one in built("clockwork").instances if 10 <= one.object < 20]
    speeds = []
    for one in gears:
        a, b = one.pose(0.0).matrix, one.pose(1.0).matrix
        angle = np.arctan2((a[:3, :3].T @ b[:3, :3])[1, 0], (a[:3, :3].T @ b[:3, :3])[0, 0])
        teeth = round(float(np.linalg.norm(one.mesh.positions[:, :2], axis=1).max() / 0.0062 - 0.45 * 3.52))
        speeds.append(angle * teeth)
    np.testing.assert_allclose(np.abs(speeds), abs(speeds[0]), rtol=0.03)
    assert (np.sign(speeds[:-1]) == -np.sign(speeds[1:])).all()


@pytest.mark.parametrize(
    ("make", "expected"),
    [
        (lambda: box(1, 2, 3, 0.0), 6.0),
        (lambda: block(1, 2, 3, 0.0), 6.0),
        (lambda: ball(1.0, 96), 4 / 3 * np.pi),
        (lambda: pillow(1, 1, 1, 1.0, 96), 4 / 3 * np.pi),
        (lambda: tube([(0, 0, 0), (0, 1, 0), (0, 2, 0)], 0.5, 64), 0.5 * np.pi),
        (lambda: meshes.placed(box(1, 2, 3, 0.0), scale(-1, 2, 1), turn("x", 1.0)), 12.0),
    ],
)
def test_solids_enclose_their_volume(make: Callable[[], Mesh], expected: float) -> None:
    """Positive: the triangles face outwards, also after mirroring."""
    assert volume(make()) == pytest.approx(expected, rel=0.005)


def test_normals_are_sharp_across_a_cubes_edges_and_smooth_over_a_ball() -> None:
    cube = box(1, 1, 1, 0.0)
    assert np.sort(np.abs(cube.normals), axis=1)[:, 2].min() > 1 - 1e-6
    round_ = ball(2.0, 48)
    assert np.einsum("nc,nc->n", round_.normals, round_.positions / 2).min() > 0.995


def test_a_loft_joins_its_seam() -> None:
    """Normals at the first and last point of a ring, which lie together, are equal."""
    angle = np.linspace(0, 2 * np.pi, 12, endpoint=False)
    rings = np.stack([np.column_stack([np.cos(angle), np.sin(angle), np.full(12, z)]) for z in (0.0, 1.0)])
    mesh = loft(rings, crease=60)
    seam = np.abs(mesh.positions - (1, 0, 0)).max(axis=1) < 1e-6
    side = mesh.normals[seam & (np.abs(mesh.normals[:, 2]) < 0.5)]
    assert len(side) >= 1
    np.testing.assert_allclose(side, np.tile([[1, 0, 0]], (len(side), 1)), atol=1e-5)


def test_textures_tile() -> None:
    """The step across the border is no larger than the steps inside."""
    rng = np.random.default_rng(0)
    for image in (lattice_noise(rng, 64, (4, 8)), clouds(rng, 64, 2, 3), spectral(rng, 64, 2.0), cells(rng, 64, 5)[0]):
        for axis in (0, 1):
            inside = np.abs(np.diff(image, axis=axis)).max()
            assert np.abs(np.take(image, 0, axis) - np.take(image, -1, axis)).max() <= 1.3 * inside


def test_relief_leans_away_from_the_slope() -> None:
    """A height that grows rightwards and downwards: red below the middle, green (up) above; flat is (0.5, 0.5, 1)."""
    y, x = np.mgrid[0:16, 0:16] / 16.0
    code = relief(x + y, 16.0)[8, 8]
    np.testing.assert_allclose(code, np.array([-1, 1, 1]) / np.sqrt(3) / 2 + 0.5)
    np.testing.assert_allclose(relief(np.ones((4, 4)), 5.0)[2, 2], (0.5, 0.5, 1.0))


def test_paths_pass_their_points_and_cameras_look_where_they_aim() -> None:
    points = np.array([(0, 0, 0), (1, 2, 0), (3, 1, 4)])
    np.testing.assert_allclose([along(points, t) for t in (-1, 0, 0.5, 1, 2)], points[[0, 0, 1, 2, 2]])
    np.testing.assert_allclose(turn("z", np.pi / 2) @ (1, 0, 0, 1), (0, 1, 0, 1), atol=1e-12)
    camera = aim((1, 2, 3), (4, 0, -1))
    np.testing.assert_allclose(np.linalg.inv(camera) @ (4, 0, -1, 1), (0, 0, -np.sqrt(29), 1), atol=1e-9)
    assert camera[1, 0] == pytest.approx(0)
    np.testing.assert_allclose(move(1, 2, 3) @ scale(2) @ (1, 1, 1, 1), (3, 4, 5, 1))


def test_the_dome_is_brightest_towards_its_sun() -> None:
    towards = -sun_travel(0.5, 1.2)
    np.testing.assert_allclose(towards, (np.cos(0.5) * np.sin(1.2), np.sin(0.5), -np.cos(0.5) * np.cos(1.2)))
    sky = dome((0.2, 0.4, 0.7), (0.6, 0.7, 0.8), (0.3, 0.3, 0.3), towards, (3.0, 3.0, 3.0), 48)
    peak = directions(48).reshape(-1, 3)[sky.sum(axis=-1).argmax()]
    assert peak @ towards > 0.98
