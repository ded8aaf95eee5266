"""glTF reading, against tiny files written here whose every number is known."""

import base64
import io
import json
import struct
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from framecast.render import gltf
from framecast.render.geometry import shape
from framecast.render.scene import Scene

KINDS = {np.int8: 5120, np.uint8: 5121, np.int16: 5122, np.uint16: 5123, np.uint32: 5125, np.float32: 5126}
SHAPES = {(): "SCALAR", (2,): "VEC2", (3,): "VEC3", (4,): "VEC4", (4, 4): "MAT4"}
SQUARE = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)]
HALF = 2**-0.5


@dataclass
class Writer:
    """Collects the parts of one glTF file."""

    blob: bytes = b""
    json: dict = field(default_factory=lambda: {"asset": {"version": "2.0"}, "accessors": [], "bufferViews": []})

    def view(self, data: bytes, **more: object) -> int:
        self.blob += bytes(-len(self.blob) % 4)
        self.json["bufferViews"].append({"buffer": 0, "byteOffset": len(self.blob), "byteLength": len(data), **more})
        self.blob += data
        return len(self.json["bufferViews"]) - 1

    def accessor(self, values: object, kind: type = np.float32, **more: object) -> int:
        array = np.asarray(values, kind)
        entry = {"componentType": KINDS[kind], "count": len(array), "type": SHAPES[array.shape[1:]], **more}
        data = array.swapaxes(-1, -2) if array.ndim == 3 else array
        self.json["accessors"].append({"bufferView": self.view(data.tobytes()), **entry})
        return len(self.json["accessors"]) - 1

    def square(self, **more: object) -> dict:
        """A primitive: the unit square in xy."""
        attributes = {"POSITION": self.accessor(SQUARE), **more.pop("attributes", {})}  # type: ignore[dict-item]
        return {"attributes": attributes, "indices": self.accessor([0, 1, 2, 0, 2, 3], np.uint16), **more}

    def animate(self, node: int, path: str, times: list, values: list, interpolation: str = "LINEAR") -> None:
        animation = self.json.setdefault("animations", [{"name": "move", "channels": [], "samplers": []}])[0]
        sampler = {"input": self.accessor(times), "output": self.accessor(values), "interpolation": interpolation}
        animation["samplers"].append(sampler)
        target = {"node": node, "path": path}
        animation["channels"].append({"sampler": len(animation["samplers"]) - 1, "target": target})

    def save(self, folder: Path, binary: bool = False, **more: object) -> Path:
        self.json.update(more)
        self.json.setdefault("scenes", [{"nodes": [0]}])
        if binary:
            self.json["buffers"] = [{"byteLength": len(self.blob)}]
            text = json.dumps(self.json).encode()
            text += b" " * (-len(text) % 4)
            blob = self.blob + bytes(-len(self.blob) % 4)
            chunks = struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(blob), b"BIN\0") + blob
            path = folder / "test.glb"
            path.write_bytes(struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks)
            return path
        uri = "data:application/octet-stream;base64," + base64.b64encode(self.blob).decode()
        self.json.setdefault("buffers", [{"byteLength": len(self.blob), "uri": uri}])
        path = folder / "test.gltf"
        path.write_text(json.dumps(self.json))
        return path


def square_file(writer: Writer, folder: Path, **more: object) -> Path:
    meshes = more.pop("meshes", None) or [{"primitives": [writer.square()]}]
    return writer.save(folder, meshes=meshes, **{"nodes": [{"mesh": 0}], **more})


def position(scene: Scene, time: float) -> np.ndarray:
    return np.asarray(scene.instances[0].pose(time).matrix)[:3, 3]


def world(scene: Scene, index: int, time: float) -> np.ndarray:
    """Vertices of an instance in the world."""
    one = scene.instances[index]
    pose = one.pose(time)
    return shape(one.mesh, pose).positions.astype(float) @ pose.matrix[:3, :3].T + pose.matrix[:3, 3]


@pytest.mark.parametrize("binary", [False, True])
def test_a_square_arrives_whole_with_flat_normals_and_the_default_material(tmp_path: Path, binary: bool) -> None:
    writer = Writer()
    path = writer.save(tmp_path, binary, meshes=[{"primitives": [writer.square()]}], nodes=[{"mesh": 0}])
    mesh, material = (one := gltf.load(path).instances[0]).mesh, one.material
    corners = mesh.positions[mesh.indices]
    np.testing.assert_array_equal(corners, np.array(SQUARE, np.float32)[[0, 1, 2, 0, 2, 3]])
    np.testing.assert_allclose(mesh.normals, np.tile([[0, 0, 1]], (6, 1)))
    assert (material.metallic, material.roughness, material.alpha_mode) == (1.0, 1.0, "opaque")


def test_flat_normals_do_not_bleed_over_an_edge(tmp_path: Path) -> None:
    writer = Writer()
    roof = writer.accessor([(0, 0, 0), (0, 0, 1), (1, 1, 0), (1, 1, 1), (2, 0, 0), (2, 0, 1)])
    primitive = {
        "attributes": {"POSITION": roof},
        "indices": writer.accessor([0, 1, 2, 2, 1, 3, 2, 3, 4, 4, 3, 5], np.uint8),
    }
    normals = gltf.load(square_file(writer, tmp_path, meshes=[{"primitives": [primitive]}])).instances[0].mesh.normals
    np.testing.assert_allclose(normals[:6], np.tile([[-HALF, HALF, 0]], (6, 1)), atol=1e-6)
    np.testing.assert_allclose(normals[6:], np.tile([[HALF, HALF, 0]], (6, 1)), atol=1e-6)


def test_strips_and_fans_become_the_same_triangles_facing_the_same_way(tmp_path: Path) -> None:
    writer = Writer()
    strip = {"attributes": {"POSITION": writer.accessor([SQUARE[k] for k in (0, 1, 3, 2)])}, "mode": 5}
    fan = {"attributes": {"POSITION": writer.accessor(SQUARE)}, "mode": 6}
    points = {"attributes": {"POSITION": writer.accessor(SQUARE)}, "mode": 0}
    scene = gltf.load(square_file(writer, tmp_path, meshes=[{"primitives": [strip, points, fan]}]))
    assert len(scene.instances) == 3  # strip, fan and the added floor; points are left out
    for one in scene.instances[:2]:
        p = one.mesh.positions[one.mesh.indices.reshape(-1, 3)]
        np.testing.assert_allclose(np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])[:, 2], [1, 1])


def test_normalised_integers_interleaving_and_sparse_values(tmp_path: Path) -> None:
    """uv 0 and 65535 are 0 and 1; positions 20 bytes apart; one position replaced by a sparse entry."""
    writer = Writer()
    rows = [struct.pack("<3f", *p) + struct.pack("<2H", 65535 * (k % 2), 65535) + b"skip" for k, p in enumerate(SQUARE)]
    view = writer.view(b"".join(rows), byteStride=20)
    where, what = (
        writer.view(np.array([2], np.uint8).tobytes()),
        writer.view(np.array([(5, 6, 7)], np.float32).tobytes()),
    )
    sparse = {"count": 1, "indices": {"bufferView": where, "componentType": 5121}, "values": {"bufferView": what}}
    writer.json["accessors"] = [
        {"bufferView": view, "componentType": 5126, "count": 4, "type": "VEC3", "sparse": sparse},
        {"bufferView": view, "byteOffset": 12, "componentType": 5123, "normalized": True, "count": 4, "type": "VEC2"},
    ]
    normals = writer.accessor(np.tile([[0, 0, -127]], (4, 1)), np.int8, normalized=True)
    writer.json["bufferViews"][-1]["byteLength"] = 12
    attributes = {"POSITION": 0, "TEXCOORD_0": 1, "NORMAL": normals}
    mesh = (
        gltf.load(square_file(writer, tmp_path, meshes=[{"primitives": [{"attributes": attributes, "mode": 6}]}]))
        .instances[0]
        .mesh
    )
    np.testing.assert_array_equal(mesh.positions, [SQUARE[0], SQUARE[1], (5, 6, 7), SQUARE[3]])
    np.testing.assert_array_equal(mesh.uvs, [(0, 1), (1, 1), (0, 1), (1, 1)])
    np.testing.assert_array_equal(mesh.normals, np.tile([[0, 0, -1]], (4, 1)))


def test_linear_rotation_is_a_slerp_along_the_short_way(tmp_path: Path) -> None:
    """90 degrees about y in one second, the second key written with the opposite sign: 30 degrees after a third."""
    writer = Writer()
    writer.animate(0, "rotation", [0.0, 1.0], [(0, 0, 0, 1), (0, -HALF, 0, -HALF)])
    scene = gltf.load(square_file(writer, tmp_path), fps=30)
    corner = world(scene, 0, 10)[1]
    np.testing.assert_allclose(corner, (np.cos(np.radians(30)), 0, -np.sin(np.radians(30))), atol=1e-6)
    assert scene.instances[0].object == 1
    assert scene.frames == 30


def test_step_holds_and_cubic_splines_follow_hermite(tmp_path: Path) -> None:
    """Cubic from 0 to 1 with zero slopes: 0.5 half way, 0.15625 at a quarter; a first slope of 4 adds 4 · 0.140625."""
    writer = Writer()
    writer.animate(
        0, "translation", [0.0, 1.0], [(0, 0, 0), (0, 0, 0), (0, 4, 0), (0, 0, 0), (1, 1, 0), (0, 0, 0)], "CUBICSPLINE"
    )
    writer.animate(0, "scale", [0.0, 0.5, 1.0], [(1, 1, 1), (2, 2, 2), (3, 3, 3)], "STEP")
    scene = gltf.load(square_file(writer, tmp_path), fps=8)
    np.testing.assert_allclose(position(scene, 4)[0], 0.5, atol=1e-6)
    np.testing.assert_allclose(position(scene, 2), (0.15625, 0.15625 + 4 * 0.140625, 0), atol=1e-6)
    assert [float(scene.instances[0].pose(t).matrix[0, 0]) for t in (0, 3.9, 4, 7.9)] == [1, 1, 2, 2]


def test_closed_animations_repeat_and_open_ones_hold_their_ends(tmp_path: Path) -> None:
    there = Writer()
    there.animate(0, "translation", [0.0, 1.0], [(0, 0, 0), (2, 0, 0)])
    scene = gltf.load(square_file(there, tmp_path), fps=10)
    assert [float(position(scene, t)[0]) for t in (-5, 5, 15)] == [0, 1, 2]
    back = Writer()
    back.animate(0, "translation", [0.0, 0.5, 1.0], [(0, 0, 0), (2, 0, 0), (0, 0, 0)])
    scene = gltf.load(square_file(back, tmp_path), fps=10)
    np.testing.assert_allclose([position(scene, t)[0] for t in (-7.5, 2.5, 12.5)], [1, 1, 1])


def strip_file(folder: Path) -> Path:
    """A strip of three rows at y = 0, 1, 2; the upper joint at y = 1 turns by 90 degrees about z in a second."""
    writer = Writer()
    rows = [(x, y, 0) for y in (0, 1, 2) for x in (0, 1)]
    joints = np.array([(0, 1, 0, 0)] * 6)
    weights = np.array([(1, 0, 0, 0)] * 2 + [(0.5, 0.5, 0, 0)] * 2 + [(0, 1, 0, 0)] * 2)
    binds = np.tile(np.eye(4), (2, 1, 1))
    binds[1, 1, 3] = -1
    attributes = {
        "POSITION": writer.accessor(rows),
        "NORMAL": writer.accessor([(0, 0, 1)] * 6),
        "JOINTS_0": writer.accessor(joints, np.uint8),
        "WEIGHTS_0": writer.accessor(weights),
    }
    primitive = {"attributes": attributes, "indices": writer.accessor([0, 1, 2, 2, 1, 3, 2, 3, 4, 4, 3, 5], np.uint16)}
    writer.animate(2, "rotation", [0.0, 1.0], [(0, 0, 0, 1), (0, 0, HALF, HALF)])
    nodes = [
        {"mesh": 0, "skin": 0, "translation": [9, 9, 9]},
        {"children": [2], "translation": [3, 0, 0]},
        {"translation": [0, 1, 0]},
    ]
    skins = [{"joints": [1, 2], "inverseBindMatrices": writer.accessor(binds)}]
    return writer.save(
        folder, meshes=[{"primitives": [primitive]}], nodes=nodes, skins=skins, scenes=[{"nodes": [0, 1]}]
    )


def test_a_skin_follows_its_joints_and_not_its_own_node(tmp_path: Path) -> None:
    scene = gltf.load(strip_file(tmp_path), fps=1)
    np.testing.assert_allclose(world(scene, 0, 0), [(3 + x, y, 0) for y in (0, 1, 2) for x in (0, 1)], atol=1e-6)
    bent = world(scene, 0, 1)
    np.testing.assert_allclose(bent[:2], [(3, 0, 0), (4, 0, 0)], atol=1e-6)
    np.testing.assert_allclose(bent[4:], [(2, 1, 0), (2, 2, 0)], atol=1e-6)  # (x, 2) turned about (3, 1)
    np.testing.assert_allclose(bent[3], np.mean([(4, 1, 0), (3, 2, 0)], axis=0), atol=1e-6)
    assert scene.instances[0].object == 1


def test_shape_keys_follow_their_weights(tmp_path: Path) -> None:
    writer = Writer()
    targets = [{"POSITION": writer.accessor([(0, 0, 1)] * 4)}, {"POSITION": writer.accessor([(0, 2, 0)] * 4)}]
    primitive = writer.square(attributes={"NORMAL": writer.accessor([(0, 0, 1)] * 4)}, targets=targets)
    writer.animate(0, "weights", [0.0, 1.0], [0.0, 1.0, 1.0, 0.0])
    scene = gltf.load(square_file(writer, tmp_path, meshes=[{"primitives": [primitive]}]), fps=4)
    np.testing.assert_allclose(world(scene, 0, 1)[0], (0, 1.5, 0.25), atol=1e-6)
    assert scene.instances[0].object == 1


def test_resting_weights_come_from_the_node_before_the_mesh(tmp_path: Path) -> None:
    writer = Writer()
    primitive = writer.square(targets=[{"POSITION": writer.accessor([(0, 0, 1)] * 4)}])
    path = square_file(
        writer, tmp_path, meshes=[{"primitives": [primitive], "weights": [0.5]}], nodes=[{"mesh": 0, "weights": [0.25]}]
    )
    scene = gltf.load(path)
    np.testing.assert_allclose(world(scene, 0, 0)[:, 2], 0.25)
    assert scene.instances[0].object == 0


def test_what_moves_together_is_one_object_and_the_rest_is_none(tmp_path: Path) -> None:
    writer = Writer()
    writer.animate(1, "translation", [0.0, 1.0], [(0, 0, 0), (1, 0, 0)])
    writer.animate(4, "translation", [0.0, 1.0], [(0, 0, 0), (0, 1, 0)])
    nodes = [
        {"children": [1, 4, 5]},
        {"mesh": 0, "children": [2]},
        {"children": [3]},
        {"mesh": 0},
        {"mesh": 0},
        {"mesh": 0},
    ]
    scene = gltf.load(square_file(writer, tmp_path, nodes=nodes))
    assert [one.object for one in scene.instances] == [1, 2, 0, 1, 0]  # the last is the added floor


def test_the_camera_of_the_file_is_used_without_its_parents_scale(tmp_path: Path) -> None:
    writer = Writer()
    nodes = [
        {"mesh": 0, "children": [1], "scale": [2, 2, 2]},
        {"camera": 0, "translation": [1, 2, 3], "rotation": [0, HALF, 0, HALF]},
    ]
    cameras = [{"type": "perspective", "perspective": {"yfov": 0.7, "znear": 0.25}}]
    scene = gltf.load(square_file(writer, tmp_path, nodes=nodes, cameras=cameras))
    expected = np.array([(0, 0, 1, 2), (0, 1, 0, 4), (-1, 0, 0, 6), (0, 0, 0, 1)])
    np.testing.assert_allclose(scene.camera.at(0), expected, atol=1e-6)
    assert (scene.camera.vertical_fov, scene.camera.near) == (0.7, 0.25)
    assert len(scene.instances) == 1  # no floor under a scene that brings its own view


def test_a_spot_light_shines_along_its_nodes_minus_z_and_sets_the_exposure(tmp_path: Path) -> None:
    """1000 candela, 10 m from the middle of the square: irradiance 10, shown at 1.5 on white."""
    writer = Writer()
    spot = {
        "type": "spot",
        "intensity": 1000,
        "color": [1, 0.5, 0.25],
        "range": 40,
        "spot": {"outerConeAngle": 0.6, "innerConeAngle": 0.2},
    }
    nodes = [
        {"mesh": 0, "children": [1]},
        {
            "translation": [10.5, 0.5, 0],
            "rotation": [0, HALF, 0, HALF],
            "extensions": {"KHR_lights_punctual": {"light": 0}},
        },
    ]
    scene = gltf.load(
        square_file(writer, tmp_path, nodes=nodes, extensions={"KHR_lights_punctual": {"lights": [spot]}})
    )
    (light,) = scene.lights
    pose = light.at(0.0)
    np.testing.assert_allclose(pose.direction, (-1, 0, 0), atol=1e-6)
    np.testing.assert_allclose(pose.position, (10.5, 0.5, 0))
    assert (light.kind, light.color, light.intensity) == ("spot", (1.0, 0.5, 0.25), 1000.0)
    assert (light.inner_cone, light.outer_cone, light.reach) == (0.2, 0.6, 40.0)
    assert scene.exposure(0.0) * 10 / np.pi == pytest.approx(1.5)


def png(colour: tuple[int, ...], size: tuple[int, int] = (2, 1)) -> bytes:
    stream = io.BytesIO()
    Image.new("RGBA", size, colour).save(stream, "PNG")
    return stream.getvalue()


def test_textures_are_found_in_the_buffer_in_the_text_and_beside_the_file(tmp_path: Path) -> None:
    writer = Writer()
    (tmp_path / "a surface.png").write_bytes(png((0, 128, 255, 255)))
    images = [
        {"bufferView": writer.view(png((10, 20, 30, 40))), "mimeType": "image/png"},
        {"uri": "data:image/png;base64," + base64.b64encode(png((128, 128, 255, 255))).decode()},
        {"uri": "a%20surface.png"},
    ]
    surface = {"baseColorTexture": {"index": 0}, "metallicRoughnessTexture": {"index": 2}, "roughnessFactor": 0.5}
    material = {
        "pbrMetallicRoughness": surface,
        "normalTexture": {"index": 1, "scale": 0.3},
        "alphaMode": "MASK",
        "alphaCutoff": 0.1,
        "doubleSided": True,
    }
    textures = [{"source": 0}, {"source": 1, "sampler": 0}, {"source": 2, "sampler": 1}]
    samplers = [{"wrapS": 33071, "wrapT": 33071}, {"wrapS": 33648, "wrapT": 33648}]
    path = square_file(
        writer,
        tmp_path,
        meshes=[{"primitives": [writer.square(material=0)]}],
        materials=[material],
        images=images,
        textures=textures,
        samplers=samplers,
    )
    got = gltf.load(path).instances[0].material
    assert got.base_texture is not None
    assert got.normal_texture is not None
    assert got.roughness_metallic_texture is not None
    assert got.base_texture.pixels.tolist() == [[[10, 20, 30, 40]] * 2]
    assert (got.base_texture.srgb, got.normal_texture.srgb, got.roughness_metallic_texture.srgb) == (True, False, False)
    assert (got.base_texture.repeat, got.normal_texture.repeat) == (True, False)
    assert got.roughness_metallic_texture.pixels.shape == (2, 4, 4)  # mirrored repeats hold their mirror image
    assert got.roughness_metallic_texture.pixels[0, 0].tolist() == [0, 128, 255, 255]
    assert (got.roughness, got.metallic, got.normal_scale, got.alpha_mode, got.alpha_cutoff, got.double_sided) == (
        0.5,
        1.0,
        0.3,
        "mask",
        0.1,
        True,
    )


def test_texture_transforms_and_emissive_strength(tmp_path: Path) -> None:
    """uv' = offset + rotation by 90 degrees of (2u, 3v): (u, v) -> (0.1 + 3v, 0.2 - 2u)."""
    writer = Writer()
    shift = {"KHR_texture_transform": {"offset": [0.1, 0.2], "rotation": np.pi / 2, "scale": [2, 3], "texCoord": 1}}
    material = {
        "pbrMetallicRoughness": {"baseColorTexture": {"index": 0, "extensions": shift}},
        "emissiveFactor": [1, 0.5, 0],
        "extensions": {"KHR_materials_emissive_strength": {"emissiveStrength": 8}},
    }
    uvs = writer.accessor([(0, 0), (1, 0), (1, 1), (0, 1)])
    primitive = writer.square(material=0, attributes={"TEXCOORD_1": uvs, "NORMAL": writer.accessor([(0, 0, 1)] * 4)})
    images = [{"bufferView": writer.view(png((1, 2, 3, 4))), "mimeType": "image/png"}]
    path = square_file(
        writer,
        tmp_path,
        meshes=[{"primitives": [primitive]}],
        materials=[material],
        images=images,
        textures=[{"source": 0}],
        extensionsRequired=["KHR_texture_transform"],
    )
    one = gltf.load(path).instances[0]
    np.testing.assert_allclose(one.mesh.uvs, [(0.1, 0.2), (0.1, -1.8), (3.1, -1.8), (3.1, 0.2)], atol=1e-6)
    assert one.material.emissive == (8.0, 4.0, 0.0)


def test_a_bare_model_is_circled_at_a_constant_distance_and_stays_in_view(tmp_path: Path) -> None:
    scene = gltf.load(square_file(Writer(), tmp_path), frames=12)
    cameras = [scene.camera.at(t) for t in (0.0, 30.0, 90.0)]
    eyes = np.array([c[:3, 3] - (0.5, 0.5, 0) for c in cameras])
    np.testing.assert_allclose(np.linalg.norm(eyes, axis=1), np.linalg.norm(eyes[0]))
    assert np.linalg.norm(eyes[2] - eyes[0]) > 1
    for camera in cameras:
        seen = (np.array(SQUARE) - camera[:3, 3]) @ camera[:3, :3]
        assert (np.abs(seen[:, :2]) < -seen[:, 2:] * np.tan(scene.camera.vertical_fov / 2)).all()
    floor = scene.instances[-1].mesh.positions
    assert -0.01 < floor[:, 1].max() < 0
    assert scene.frames == 12


def refused(path: Path, kind: type[Exception], *words: str, **options: object) -> None:
    with pytest.raises(kind) as error:
        gltf.load(path, **options)  # type: ignore[arg-type]
    for word in words:
        assert word in str(error.value)


def test_bad_files_are_refused_with_what_to_do(tmp_path: Path) -> None:
    refused(tmp_path / "none.glb", FileNotFoundError, "none.glb", "give the path")
    (tmp_path / "text.gltf").write_text("no json")
    refused(tmp_path / "text.gltf", ValueError, "is not a glTF file")
    (tmp_path / "short.glb").write_bytes(b"glTF\2\0\0\0")
    refused(tmp_path / "short.glb", ValueError, "is not a glTF file")
    refused(square_file(Writer(), tmp_path, asset={"version": "1.0"}), ValueError, "1.0", "2.0")
    path = square_file(Writer(), tmp_path, extensionsRequired=["KHR_draco_mesh_compression"])
    refused(path, ValueError, "KHR_draco_mesh_compression", "without compression")
    path = square_file(Writer(), tmp_path, buffers=[{"uri": "away.bin", "byteLength": 4}])
    refused(path, FileNotFoundError, "away.bin", "copy that file")
    refused(square_file(Writer(), tmp_path, nodes=[{}]), ValueError, "no triangles")
    refused(square_file(Writer(), tmp_path), ValueError, "no animation 'run'", animation="run")
    writer = Writer()
    path = square_file(writer, tmp_path, buffers=[{"byteLength": 9999, "uri": "data:;base64,AAAA"}])
    refused(path, ValueError, "cut short")
