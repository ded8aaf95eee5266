"""Small Blender renders whose depth and motion are known on paper, for the tests of the Blender importer.

    python examples/blender/fixtures.py OUT                        # the bpy module, Blender 5
    blender -b -P examples/blender/fixtures.py -- OUT v34-ortho    # an installed Blender, 3.4 or newer; only that one

The scene: a camera looks down -z from (cx, cy, 8) at the plane z = 0; a unit cube whose front face lies at z = 4 moves
in front of it with constant acceleration; past the plane's right edge there is only sky. The lens is 36 mm on a 36 mm
sensor at 64 pixels, so one unit is 8 pixels on the plane and 16 on the cube's face, and every speed is a round number.

Each fixture is a folder of multilayer EXRs and a `shot.json`. `truth.json` beside them holds, per fixture and frame,
`probes`: a pixel (x, y down), the surface there, its depth and object index, and where that surface point was one
frame earlier and will be one frame later, relative to the pixel.
The probes come from the formulas below, never from a render.
"""

import json
import math
import sys
import tempfile
from dataclasses import dataclass, field
from pathlib import Path

import bpy
import mathutils

WIDTH, HEIGHT, FPS = 64, 36, 24
LENS_MM = SENSOR_MM = 36.0
CAMERA_Z, PLANE_SIZE, PLANE_EDGE_X, CUBE_FACE_Z, CUBE_HALF = 8.0, 40.0, 2.5, 4.0, 0.5
ORTHO_SCALE = 16.0
PAN_DEGREES = 1.5
CUBE_INDEX = 7
SKY_DEPTH = 1e10
VERSION = bpy.app.version
PASSES = ("z", "normal", "vector", "diffuse_color", "object_index")
ALL_PASSES = (
    *PASSES,
    *("mist", "position", "uv", "material_index", "emit", "environment", "ambient_occlusion", "diffuse_direct"),
    *("diffuse_indirect", "glossy_direct", "glossy_indirect", "glossy_color", "cryptomatte_object"),
)


@dataclass(frozen=True)
class Fixture:
    """One folder of renders. `kind` is the camera: translate, pan, ortho or panorama."""

    name: str
    frames: tuple[int, ...] = (3, 4, 5)
    step: int = 1
    kind: str = "translate"
    codec: str = "ZIP"
    depth: str = "32"
    passes: tuple[str, ...] = PASSES
    layers: tuple[str, ...] = ("ViewLayer",)
    motion_blur: bool = False
    nodes: bool = False
    interleave: bool = False
    size: tuple[int, int] = field(default=(WIDTH, HEIGHT))


FIXTURES = {
    5: (
        Fixture("v5", passes=ALL_PASSES),
        Fixture("v5-half-dwaa", codec="DWAA", depth="16"),
        Fixture("v5-one-part", frames=(4, 5), interleave=True),
        Fixture("v5-two-layers", frames=(4, 5), layers=("Main", "Second")),
        Fixture("v5-nodes", frames=(4, 5), nodes=True),
        Fixture("step2", frames=(1, 3, 5, 7), step=2),
        Fixture("motion-blur", motion_blur=True),
        Fixture("pan", kind="pan"),
        Fixture("ortho", frames=(4, 5), kind="ortho"),
        Fixture("panorama", frames=(4, 5), kind="panorama", size=(64, 32)),
    ),
    3: (
        Fixture("v34"),
        Fixture("v34-nodes", frames=(4, 5), nodes=True),
        Fixture("v34-motion-blur", frames=(4, 5), motion_blur=True),
        Fixture("v34-ortho", frames=(4,), kind="ortho"),
        Fixture("v34-panorama", frames=(4,), kind="panorama", size=(64, 32)),
    ),
}


# The motion, on paper. u = frame - 4.


def camera_position(kind: str, frame: float) -> mathutils.Vector:
    """World position of the camera: 2 pixels a frame to the right and 1 up, as seen on the plane."""
    u = 0.0 if kind == "pan" else frame - 4
    return mathutils.Vector((0.25 * u, 0.125 * u, CAMERA_Z))


def camera_rotation(kind: str, frame: float) -> mathutils.Matrix:
    """Camera to world rotation: identity looks down -z with +y up; a pan turns to the left about y."""
    return mathutils.Matrix.Rotation(math.radians(PAN_DEGREES) * (frame - 4) if kind == "pan" else 0.0, 3, "Y")


def cube_centre(frame: float) -> mathutils.Vector:
    """World position of the cube: against the translating camera it accelerates by (1, -1) pixels a frame², y up."""
    u = frame - 4
    camera = camera_position("translate", frame)
    return mathutils.Vector(
        (camera.x + (0.5 * u * u + 3 * u - 8) / 16, camera.y + (4 - 0.5 * u * u) / 16, CUBE_FACE_Z - CUBE_HALF)
    )


def pixel_ray(fixture: Fixture, x: float, y: float) -> tuple[mathutils.Vector, mathutils.Vector]:
    """Origin and direction in camera space of the ray through image position (x, y down), pixel centres at +0.5."""
    w, h = fixture.size
    if fixture.kind == "ortho":
        scale = ORTHO_SCALE / w
        return mathutils.Vector(((x - w / 2) * scale, (h / 2 - y) * scale, 0)), mathutils.Vector((0, 0, -1))
    if fixture.kind == "panorama":
        lon, lat = (x / w - 0.5) * 2 * math.pi, (0.5 - y / h) * math.pi
        direction = (math.cos(lat) * math.sin(lon), math.sin(lat), -math.cos(lat) * math.cos(lon))
        return mathutils.Vector((0, 0, 0)), mathutils.Vector(direction)
    focal = w * LENS_MM / SENSOR_MM
    return mathutils.Vector((0, 0, 0)), mathutils.Vector(((x - w / 2) / focal, (h / 2 - y) / focal, -1))


def project(fixture: Fixture, point: mathutils.Vector) -> tuple[float, float]:
    """Image position (x, y down) of a point in camera space: the inverse of `pixel_ray`."""
    w, h = fixture.size
    if fixture.kind == "ortho":
        return w / 2 + point.x * w / ORTHO_SCALE, h / 2 - point.y * w / ORTHO_SCALE
    if fixture.kind == "panorama":
        lon, lat = math.atan2(point.x, -point.z), math.asin(point.y / point.length)
        return (lon / (2 * math.pi) + 0.5) * w, (0.5 - lat / math.pi) * h
    focal = w * LENS_MM / SENSOR_MM
    return w / 2 - focal * point.x / point.z, h / 2 + focal * point.y / point.z


def hit(fixture: Fixture, frame: int, x: float, y: float) -> tuple[str, mathutils.Vector]:
    """Surface (cube, plane or sky) seen at an image position, and the world point (the direction, for the sky)."""
    rotation, position = camera_rotation(fixture.kind, frame), camera_position(fixture.kind, frame)
    origin, direction = pixel_ray(fixture, x, y)
    origin, direction = rotation @ origin + position, rotation @ direction
    if abs(direction.z) < 1e-9 or direction.z > 0:
        return "sky", direction
    at_face = origin + direction * ((CUBE_FACE_Z - origin.z) / direction.z)
    offset = at_face - cube_centre(frame)
    if max(abs(offset.x), abs(offset.y)) <= CUBE_HALF:
        return "cube", at_face
    at_plane = origin + direction * (-origin.z / direction.z)
    on_plane = PLANE_EDGE_X - PLANE_SIZE < at_plane.x < PLANE_EDGE_X and abs(at_plane.y) < PLANE_SIZE / 2
    return ("plane", at_plane) if on_plane else ("sky", direction)


def motion(fixture: Fixture, frame: int, step: int, pixel: tuple[float, float]) -> list[float]:
    """Pixels (x right, y down) from an image position to where the same surface point is `step` frames away."""
    surface, point = hit(fixture, frame, *pixel)
    rotation = camera_rotation(fixture.kind, frame + step).transposed()
    if surface == "sky":
        moved = rotation @ point
        return [0.0, 0.0] if fixture.kind == "ortho" else _difference(project(fixture, moved), pixel)
    if surface == "cube":
        point = point + cube_centre(frame + step) - cube_centre(frame)
    return _difference(project(fixture, rotation @ (point - camera_position(fixture.kind, frame + step))), pixel)


def _difference(a: tuple[float, float], b: tuple[float, float]) -> list[float]:
    return [round(a[0] - b[0], 6), round(a[1] - b[1], 6)]


def neighbours(fixture: Fixture, frame: int, pixel: tuple[float, float], surface: str) -> set[str]:
    """Surfaces 3 pixels around an image position; 6 when it is not the cube, whose sides `hit` knows nothing of."""
    reach = (-3, 0, 3) if surface == "cube" else (-6, -3, 0, 3, 6)
    close = {hit(fixture, frame, pixel[0] + i, pixel[1] + j)[0] for i in (-3, 0, 3) for j in (-3, 0, 3)}
    far = {hit(fixture, frame, pixel[0] + i, pixel[1] + j)[0] for i in reach for j in reach}
    return close | (far & {"cube"})


def probes(fixture: Fixture, frame: int) -> list[dict[str, object]]:
    """Known values at pixels on a grid, away from edges."""
    rotation, position = camera_rotation(fixture.kind, frame), camera_position(fixture.kind, frame)
    found = []
    for y in range(3, fixture.size[1] - 3, 5):
        for x in range(3, fixture.size[0] - 3, 5):
            surface, point = hit(fixture, frame, x + 0.5, y + 0.5)
            if any(other != surface for other in neighbours(fixture, frame, (x + 0.5, y + 0.5), surface)):
                continue
            local = rotation.transposed() @ (point - position)
            distance = local.length if fixture.kind == "panorama" else -local.z
            found.append(
                {
                    "pixel": [x, y],
                    "surface": surface,
                    "depth": SKY_DEPTH if surface == "sky" else round(distance, 6),
                    "object": CUBE_INDEX if surface == "cube" else 0,
                    "motion": motion(fixture, frame, -1, (x + 0.5, y + 0.5)),
                    "motion_next": motion(fixture, frame, +1, (x + 0.5, y + 0.5)),
                }
            )
    return found


# The scene and the renders.


def material(name: str, color: tuple[float, float, float], checker: float) -> bpy.types.Material:
    """A diffuse checker of `color` and a darker shade of it."""
    made = bpy.data.materials.new(name)
    made.use_nodes = True
    nodes, links = made.node_tree.nodes, made.node_tree.links
    nodes.clear()
    texture = nodes.new("ShaderNodeTexChecker")
    texture.inputs["Color1"].default_value = (*color, 1)
    texture.inputs["Color2"].default_value = (*(0.4 * c for c in color), 1)
    texture.inputs["Scale"].default_value = checker
    place = nodes.new("ShaderNodeTexCoord")
    links.new(place.outputs["Object"], texture.inputs["Vector"])
    diffuse, out = nodes.new("ShaderNodeBsdfDiffuse"), nodes.new("ShaderNodeOutputMaterial")
    links.new(texture.outputs["Color"], diffuse.inputs["Color"])
    links.new(diffuse.outputs[0], out.inputs[0])
    return made


def build(fixture: Fixture) -> bpy.types.Scene:
    """The scene of this file's docstring, keyed at every frame well past the rendered range."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    bpy.ops.mesh.primitive_plane_add(size=PLANE_SIZE, location=(PLANE_EDGE_X - PLANE_SIZE / 2, 0, 0))
    bpy.context.object.data.materials.append(material("plane", (0.6, 0.5, 0.3), 1.0))
    bpy.ops.mesh.primitive_cube_add(size=2 * CUBE_HALF)
    cube = bpy.context.object
    cube.pass_index = CUBE_INDEX
    cube.data.materials.append(material("cube", (0.2, 0.4, 0.8), 4.0))
    bpy.ops.object.light_add(type="SUN", rotation=(0.5, 0.3, 0))
    bpy.context.object.data.energy = 3.0
    bpy.context.object.data.angle = 0.0
    scene.camera = add_camera(fixture.kind)
    for frame in range(-2, 12):
        cube.location = cube_centre(frame)
        cube.keyframe_insert("location", frame=frame)
        scene.camera.location = camera_position(fixture.kind, frame)
        scene.camera.keyframe_insert("location", frame=frame)
        scene.camera.rotation_euler = camera_rotation(fixture.kind, frame).to_euler()
        scene.camera.keyframe_insert("rotation_euler", frame=frame)
    world = scene.world = bpy.data.worlds.new("world")
    world.use_nodes = True
    background = world.node_tree.nodes.get("Background") or world.node_tree.nodes.new("ShaderNodeBackground")
    background.inputs["Color"].default_value = (0.25, 0.5, 1.0, 1)
    return scene


def add_camera(kind: str) -> bpy.types.Object:
    """The camera, in the projection that the fixture asks for."""
    data = bpy.data.cameras.new("Camera")
    data.lens, data.sensor_width, data.clip_start, data.clip_end = LENS_MM, SENSOR_MM, 0.1, 100.0
    if kind == "ortho":
        data.type, data.ortho_scale = "ORTHO", ORTHO_SCALE
    if kind == "panorama":
        data.type = "PANO"
        holder = data if hasattr(data, "panorama_type") else data.cycles
        holder.panorama_type = "EQUIRECTANGULAR"
    camera = bpy.data.objects.new("Camera", data)
    bpy.context.scene.collection.objects.link(camera)
    return camera


def configure(scene: bpy.types.Scene, fixture: Fixture, folder: Path) -> None:
    """Render and output settings, the same few in every version."""
    render = scene.render
    render.engine, render.fps = "CYCLES", FPS
    render.resolution_x, render.resolution_y = fixture.size
    render.use_motion_blur = fixture.motion_blur
    scene.cycles.samples, scene.cycles.max_bounces = 8, 0
    scene.cycles.use_adaptive_sampling = scene.cycles.use_denoising = False
    scene.view_layers[0].name = fixture.layers[0]
    for extra in fixture.layers[1:]:
        scene.view_layers.new(extra)
    for layer in scene.view_layers:
        for name in fixture.passes:
            setattr(layer, f"use_pass_{name}", True)
    settings = render.image_settings
    if hasattr(settings, "media_type"):
        settings.media_type = "MULTI_LAYER_IMAGE"
    settings.file_format = "OPEN_EXR_MULTILAYER"
    settings.exr_codec, settings.color_depth = fixture.codec, fixture.depth
    if hasattr(settings, "use_exr_interleave"):
        settings.use_exr_interleave = fixture.interleave
    render.filepath = f"{folder}/####.exr"
    scene.frame_start, scene.frame_end, scene.frame_step = fixture.frames[0], fixture.frames[-1], fixture.step
    if fixture.nodes:
        add_output_node(scene, folder)
        render.filepath = f"{tempfile.mkdtemp()}/####.exr"


def add_output_node(scene: bpy.types.Scene, folder: Path) -> None:
    """Compositor: a multilayer File Output node, whose layers carry no view-layer prefix."""
    if hasattr(scene, "compositing_node_group"):
        tree = scene.compositing_node_group = bpy.data.node_groups.new("compositing", "CompositorNodeTree")
    else:
        scene.use_nodes = True
        tree = scene.node_tree
        tree.nodes.clear()
    layers, out = tree.nodes.new("CompositorNodeRLayers"), tree.nodes.new("CompositorNodeOutputFile")
    layers.scene = scene
    format_ = out.format
    if hasattr(format_, "media_type"):
        format_.media_type = "MULTI_LAYER_IMAGE"
    format_.file_format, format_.color_depth = "OPEN_EXR_MULTILAYER", "32"
    format_.exr_codec = "ZIP"
    wanted = [s for s in layers.outputs if s.enabled and s.name not in ("Alpha", "Noisy Image")]
    if hasattr(out, "file_output_items"):
        out.directory, out.file_name = str(folder), "####"
        out.file_output_items.clear()
        for socket in wanted:
            kind = {"VALUE": "FLOAT", "RGBA": "RGBA"}.get(socket.type, socket.type)
            item = out.file_output_items.new(kind, socket.name)
            if kind == "VECTOR" and socket.name == "Vector":
                item.vector_socket_dimensions = 4
    else:
        out.base_path = f"{folder}/####"
        out.layer_slots.clear()
        for socket in wanted:
            out.layer_slots.new(socket.name)
    for socket in wanted:
        tree.links.new(socket, out.inputs[socket.name])


def shot(scene: bpy.types.Scene, fixture: Fixture) -> dict[str, object]:
    """The camera of every rendered frame in Blender's convention: it looks down -z, +y up, metres and millimetres."""
    camera = scene.camera.data
    rows = []
    for frame in fixture.frames:
        scene.frame_set(frame)
        matrix = [list(row) for row in scene.camera.matrix_world]
        rows.append(
            {"frame": frame, "camera_to_world": matrix, "lens_mm": camera.lens, "sensor_mm": camera.sensor_width}
        )
    made: dict[str, object] = {
        "size": list(fixture.size),
        "fps": FPS,
        "camera": camera.type,
        "clip_start": round(camera.clip_start, 6),
        "clip_end": camera.clip_end,
        "frames": rows,
    }
    return made | ({"ortho_scale": ORTHO_SCALE} if fixture.kind == "ortho" else {})


def main(out: Path, names: list[str]) -> None:
    """Render the fixtures of the running Blender's version, or those named; merge their truths into OUT/truth.json."""
    path = out / "truth.json"
    truth = json.loads(path.read_text()) if path.exists() else {}
    for fixture in FIXTURES[5 if VERSION[0] >= 5 else 3]:
        if names and fixture.name not in names:
            continue
        folder = out / fixture.name
        folder.mkdir(parents=True, exist_ok=True)
        scene = build(fixture)
        configure(scene, fixture, folder.resolve())
        bpy.ops.render.render(animation=True)
        (folder / "shot.json").write_text(json.dumps(shot(scene, fixture), indent=1) + "\n")
        truth[fixture.name] = {
            "blender": bpy.app.version_string,
            "camera": fixture.kind,
            "step": fixture.step,
            "frames": {str(frame): probes(fixture, frame) for frame in fixture.frames},
        }
    path.write_text(json.dumps(truth, sort_keys=True) + "\n")


if __name__ == "__main__":
    arguments = sys.argv[sys.argv.index("--") + 1 :] if "--" in sys.argv else sys.argv[1:]
    main(Path(arguments[0]), arguments[1:])
