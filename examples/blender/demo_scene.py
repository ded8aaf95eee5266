"""The demo clip: a small harbour square in the evening sun, rendered by Blender Cycles with every pass we read.

    python examples/blender/demo_scene.py OUT --frames 17 --size 480x270          # the bpy module
    blender -b -P examples/blender/demo_scene.py -- OUT --frames 17               # an installed Blender

Everything in it is made here; no file is loaded. What it tests: a camera that dollies past a railing (parallax, wires,
spokes, lattice), a tram that crosses, windmill sails that turn, a ball that bounces (acceleration, squash), bunting
that flutters (deformation), lanterns that swing, moving soft shadows, reflections on water. Object Index is non-zero
on whatever moves by itself. Writes OUT/0001.exr ... (multilayer, half colour, ZIP) and OUT/shot.json.
"""

import argparse
import json
import math
import random
import sys
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import bpy
from mathutils import Vector

sys.path.insert(0, str(Path(__file__).resolve().parent))
from harbour import (
    FACADE_Y,
    HOUSES,
    QUAY_Y,
    STREET_Y,
    WATER_Z,
    Materials,
    bicycle,
    ground,
    house,
    palette,
    pot,
    railing,
    reeds,
    street_wires,
    tree,
)
from shapes import Point, Shape, add, at, ball, box, join, lathe, prism, ring, sagging, sky, tube, turned

FPS = 24
PASSES = ("z", "normal", "vector", "diffuse_color", "object_index")


def animate(made: bpy.types.Object, frames: int, **tracks: Callable[[float], object]) -> None:
    """Key properties at every frame, and one beyond each end: t counts frames from the first one."""
    for frame in range(frames + 2):
        for name, track in tracks.items():
            setattr(made, name, track(frame - 1.0))
            made.keyframe_insert(name, frame=frame)


def moving(index: int, *objects: bpy.types.Object) -> None:
    """Mark objects as things that move by themselves."""
    for one in objects:
        one.pass_index = index


def carried(parent: bpy.types.Object, *children: bpy.types.Object) -> None:
    """Attach objects to one that moves."""
    for child in children:
        child.parent = parent


def pivot(name: str, location: Point) -> bpy.types.Object:
    """An empty to hang things on."""
    made = bpy.data.objects.new(name, None)
    made.location = location
    bpy.context.scene.collection.objects.link(made)
    return made


# What moves.


def tram(m: Materials, frames: int) -> None:
    """A small tram that crosses the square from left to right."""
    root = pivot("tram", (0, STREET_Y, 0))
    body = add("body", box((0, 0, 0.62), (2.9, 0.98, 0.62)), m["red"], bevel=0.07)
    upper = add("upper", box((0, 0, 1.2), (2.8, 0.94, 0.62)), m["ivory"], bevel=0.06)
    roof = add(
        "tram roof",
        join(box((0, 0, 1.56), (3.0, 1.06, 0.12)), box((0, 0, 1.66), (1.9, 0.6, 0.12))),
        m["navy"],
        bevel=0.05,
    )
    panes = [box((-1.08 + 0.54 * k, s * 0.475, 1.2), (0.42, 0.02, 0.42)) for k in range(5) for s in (-1, 1)]
    glass = add("windows", join(*panes, box((1.405, 0, 1.2), (0.02, 0.72, 0.4))), m["glass"])
    stripe = add("stripe", join(*[box((0, s * 0.495, 0.84), (2.92, 0.02, 0.07)) for s in (-1, 1)]), m["yellow"])
    skirt = add("skirt", box((0, 0, 0.26), (2.3, 0.8, 0.2)), m["iron"])
    pole = add(
        "pole",
        join(
            tube([(-0.5, 0, 1.7), (0.05, 0, 2.35), (-0.5, 0, 2.93)], 0.025),
            tube([(-0.5, -0.45, 2.94), (-0.5, 0.45, 2.94)], 0.022),
        ),
        m["iron"],
    )
    light = add("headlight", at(turned(ball(0.09, 16), 90, "Y"), 1.45, -0.25, 0.66), m["lamp"], smooth=True)
    carried(root, body, upper, roof, glass, stripe, skirt, pole, light)
    animate(root, frames, location=lambda t: (-5.0 + 0.46 * t, STREET_Y, 0.012 * math.sin(1.3 * t)))
    moving(1, body, upper, roof, glass, stripe, skirt, pole, light)
    for wx in (-0.85, 0.85):
        spokes = [turned(box((0, 0, 0), (0.36, 0.06, 0.045)), a, "Y") for a in (0, 60, 120)]
        wheel = add("wheel", join(ring(0.19, 0.04), *spokes), m["steel"])
        wheel.location = (wx, -0.44, 0.23)
        carried(root, wheel)
        animate(wheel, frames, rotation_euler=lambda t: (0, 0.46 * t / 0.22, 0))
        moving(1, wheel)


def windmill(x: float, y: float, m: Materials, frames: int) -> None:
    """A tower mill with lattice sails."""
    add("tower", at(lathe([(1.5, 0), (1.32, 1.6), (1.05, 4.4)], 10), x, y, 0), m["white"])
    add("gallery", at(lathe([(1.2, 1.6), (1.85, 1.6), (1.85, 1.7), (1.2, 1.7)], 20), x, y, 0), m["wood"])
    posts = [(1.8 * math.cos(a), 1.8 * math.sin(a)) for a in (2 * math.pi * k / 20 for k in range(21))]
    rail = [tube([(px, py, 1.7), (px, py, 2.1)], 0.02, 5) for px, py in posts] + [
        tube([(px, py, 2.1) for px, py in posts], 0.022, 5)
    ]
    add("gallery rail", at(join(*rail), x, y, 0), m["trim"])
    add("cap", at(lathe([(1.12, 4.4), (1.16, 4.6), (0.95, 5.1), (0.5, 5.45), (0.01, 5.55)], 20), x, y, 0), m["slate"])
    for z in (1.05, 2.75, 3.6):
        add("slit", box((x - 0.1, y - 1.36 + 0.11 * z, z), (0.34, 0.2, 0.5)), m["glass"])
    sails, cloths = [], []
    for k in range(4):
        rungs = [box((0.27, 0, 0.55 + 0.19 * i), (0.56, 0.03, 0.03)) for i in range(12)]
        bars = [box((dx, 0, 1.6), (0.03, 0.03, 2.15)) for dx in (0.28, 0.54)]
        sails.append(turned(join(box((0, 0, 1.3), (0.09, 0.07, 2.6)), *rungs, *bars), 90 * k, "Y"))
        cloths.append(turned(box((-0.16, 0.01, 1.62), (0.26, 0.015, 2.05)), 90 * k, "Y"))
    hub = at(turned(lathe([(0.001, -0.3), (0.17, -0.3), (0.13, 0.3), (0.001, 0.34)]), 90, "X"), 0, 0, 0)
    frame, cloth = add("sails", join(*sails, hub), m["trim"]), add("cloth", join(*cloths), m["red"])
    root = pivot("sail axis", (x, y - 1.55, 4.5))
    carried(root, frame, cloth)
    animate(root, frames, rotation_euler=lambda t: (0, math.radians(18 + 8.5 * t), 0))
    moving(2, frame, cloth)


def bouncing_ball(m: Materials, frames: int) -> None:
    """A striped ball on parabolas, squashed where it touches the ground."""
    radius, period, height = 0.36, 13.0, 1.35
    made = add(
        "ball",
        ball(radius, 36),
        [m["yellow"], m["navy"], m["ivory"]],
        smooth=True,
        pick=lambda c: (0, 2, 1, 2)[int((math.atan2(c.y, c.x) / math.pi + 1) * 4) % 4],
    )

    def phase(t: float) -> float:
        return ((t + 7.5) / period) % 1.0

    def squash(t: float) -> float:
        return 1 - 0.3 * max(0.0, 1 - min(phase(t), 1 - phase(t)) * period / 1.6)

    def place(t: float) -> Point:
        lift = 4 * height * phase(t) * (1 - phase(t))
        return (1.15 + 0.085 * t, -0.75 - 0.02 * t, radius * squash(t) + lift)

    animate(
        made,
        frames,
        location=place,
        scale=lambda t: (squash(t) ** -0.5, squash(t) ** -0.5, squash(t)),
        rotation_euler=lambda t: (0.5, 0.17 * t, 0.3),
    )
    moving(3, made)


def boat(m: Materials, frames: int) -> None:
    """A toy sailing boat that glides to the left on the canal."""
    outline = [(-0.62, 0.3), (-0.5, 0), (0.45, 0), (0.85, 0.34)]
    hull = add(
        "hull",
        join(prism(outline, (0, 0, -0.12), (1, 0.42, 1)), box((0.05, 0, 0.2), (1.2, 0.46, 0.04))),
        m["wood"],
        bevel=0.04,
    )
    mast = add(
        "mast",
        join(
            tube([(0.1, 0, 0.2), (0.1, 0, 1.75)], 0.018),
            tube([(0.1, 0, 0.36), (-0.62, 0, 0.4)], 0.014),
            tube([(0.1, 0, 1.72), (0.84, 0, 0.24)], 0.006, 4),
        ),
        m["bark"],
    )
    sail: Shape = (
        [Vector(p) for p in ((0.07, 0, 0.42), (-0.58, 0, 0.44), (0.07, 0, 1.66), (-0.3, -0.12, 0.98))],
        [[0, 1, 3], [0, 3, 2]],
    )
    jib: Shape = ([Vector(p) for p in ((0.16, 0, 0.36), (0.74, 0, 0.36), (0.16, 0, 1.5))], [[0, 1, 2]])
    main, front = add("sail", sail, m["ivory"]), add("jib", jib, m["teal"])
    root = pivot("boat", (0, 0, 0))
    root.scale = (0.72, 0.72, 0.72)
    carried(root, hull, mast, main, front)
    animate(
        root,
        frames,
        location=lambda t: (1.1 - 0.09 * t, -3.7, WATER_Z + 0.03 * math.sin(0.55 * t)),
        rotation_euler=lambda t: (0.07 * math.sin(0.4 * t), 0.05 * math.sin(0.5 * t + 1), math.pi + 0.25),
    )
    moving(4, hull, mast, main, front)


def balloon(index: int, start: Point, colors: tuple[str, str], m: Materials, frames: int) -> None:
    """A hot-air balloon that drifts and rises."""
    profile = [
        (0.12, -1.5),
        (0.45, -1.1),
        (0.95, -0.45),
        (1.2, 0.2),
        (1.12, 0.75),
        (0.75, 1.2),
        (0.3, 1.42),
        (0.001, 1.46),
    ]
    gore = lambda c: int((math.atan2(c.y, c.x) / math.pi + 1) * 6) % 2  # noqa: E731
    envelope = add("balloon", lathe(profile, 36), [m[c] for c in colors], smooth=True, pick=gore)
    ropes = [
        tube([(0.14 * sx, 0.14 * sy, -2.05), (0.3 * sx, 0.3 * sy, -1.2)], 0.016, 4) for sx in (-1, 1) for sy in (-1, 1)
    ]
    basket = add("basket", join(box((0, 0, -2.15), (0.36, 0.36, 0.3)), *ropes), m["wood"])
    root = pivot("balloon", start)
    root.scale = (1.25, 1.25, 1.25)
    carried(root, envelope, basket)
    x, y, z = start
    animate(
        root, frames, location=lambda t: (x + 0.07 * t, y, z + 0.035 * t), rotation_euler=lambda t: (0, 0, 0.03 * t)
    )
    moving(index, envelope, basket)


def lantern_post(index: int, x: float, y: float, m: Materials, frames: int, phase: float) -> None:
    """A post whose lantern swings like a pendulum."""
    add(
        "post",
        at(lathe([(0.14, 0), (0.14, 0.12), (0.06, 0.2), (0.045, 2.9), (0.07, 2.95), (0.001, 3.1)], 16), x, y, 0),
        m["iron"],
        smooth=True,
    )
    add("arm", tube([(x, y, 2.8), (x + 0.3, y, 2.92), (x + 0.62, y, 2.8)], 0.022), m["iron"], smooth=True)
    cage = [tube([(s * 0.1, r * 0.1, -0.62), (s * 0.13, r * 0.13, -0.25)], 0.012, 4) for s in (-1, 1) for r in (-1, 1)]
    roof = at(lathe([(0.2, 0), (0.05, 0.12), (0.02, 0.2), (0.001, 0.2)], 4), 0, 0, -0.25)
    shell = add(
        "lantern",
        join(*cage, roof, box((0, 0, -0.64), (0.24, 0.24, 0.04)), tube([(0, 0, -0.05), (0, 0, 0)], 0.012)),
        m["iron"],
    )
    bulb = add("bulb", at(ball(0.085, 16), 0, 0, -0.45), m["lamp"], smooth=True)
    root = pivot("swing", (x + 0.62, y, 2.8))
    carried(root, shell, bulb)
    animate(root, frames, rotation_euler=lambda t: (0, 0.5 * math.sin(0.42 * t + phase), 0))
    moving(index, shell, bulb)


def bunting(index: int, start: Point, end: Point, m: Materials, frames: int) -> None:
    """Pennants on a wire that flutter: two shape keys in quadrature make a wave that travels."""
    path = sagging(start, end, 0.38, 15)
    add("string", tube(path, 0.01, 5), m["iron"])
    flags: Shape = join(
        *[
            ([Vector(p), Vector(q), (Vector(p) + Vector(q)) / 2 - Vector((0, 0, 0.42))], [[0, 1, 2]])
            for p, q in pairwise(path)
        ]
    )
    colors = [m[f"flag {c}"] for c in ("red", "yellow", "teal", "ivory", "navy")]
    lookup = {round(sum(v.x for v in flags[0][3 * k : 3 * k + 3]) / 3, 3): k for k in range(len(path) - 1)}
    made = add("bunting", flags, colors, pick=lambda c: lookup[round(c.x, 3)] % len(colors))
    made.shape_key_add(name="rest")
    for name, shift in (("sine", 0.0), ("cosine", math.pi / 2)):
        key = made.shape_key_add(name=name)
        key.slider_min = -1.0
        for k in range(len(path) - 1):
            swing = math.sin(0.9 * k + shift)
            key.data[3 * k + 2].co += Vector((0.11 * swing, 0.1 * swing, 0.04 * swing))
        animate(key, frames, value=lambda t, s=shift: math.cos(0.6 * t + s))
    moving(index, made)


# Camera, light, render.


def camera(frames: int) -> bpy.types.Object:
    """A dolly to the right that turns slowly, easing in a little."""
    data = bpy.data.cameras.new("Camera")
    data.lens, data.sensor_width, data.clip_start, data.clip_end = 32.0, 36.0, 0.1, 200.0
    made = bpy.data.objects.new("Camera", data)
    bpy.context.scene.collection.objects.link(made)

    def place(t: float) -> Vector:
        return Vector((-2.5 + 0.17 * t + 0.001 * t * t, -12.4 + 0.03 * t, 2.3 + 0.02 * t))

    def aim(t: float) -> object:
        target = Vector((0.0 + 0.045 * t, 3.0, 1.45))
        return (target - place(t)).to_track_quat("-Z", "Y").to_euler()

    animate(made, frames, location=place, rotation_euler=aim)
    return made


def light() -> None:
    """Low warm sun from the left behind the camera, and the sky."""
    data = bpy.data.lights.new("sun", "SUN")
    data.energy, data.color, data.angle = 4.8, (1.0, 0.76, 0.5), math.radians(2.0)
    made = bpy.data.objects.new("sun", data)
    made.rotation_euler = Vector((0.8, 0.62, -0.66)).to_track_quat("-Z", "Y").to_euler()
    bpy.context.scene.collection.objects.link(made)
    stops = [
        (0.0, (0.12, 0.12, 0.13)),
        (0.5, (1.0, 0.7, 0.45)),
        (0.54, (0.78, 0.72, 0.66)),
        (0.61, (0.3, 0.52, 0.74)),
        (1.0, (0.07, 0.2, 0.48)),
    ]
    bpy.context.scene.world = sky(stops, 0.8)


def build(frames: int) -> None:
    """The whole scene, keyed from one frame before the first to one after the last."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    m, rng = palette(frames), random.Random(3)
    ground(m)
    for x, size, wall, roof, shutters in HOUSES:
        house(x, size, m, wall, roof, shutters, rng)
    windmill(5.5, 8.6, m, frames)
    for x, y, height in ((3.35, 4.4, 2.5), (7.6, 5.0, 3.0), (-10.2, 3.0, 3.2), (3.2, 9.5, 3.6)):
        tree(x, y, height, m, rng)
    for x, color in ((-4.7, "red"), (-0.35, "yellow"), (2.25, "red"), (-2.35, "ivory")):
        pot(x, FACADE_Y - 0.45, m, color, rng)
    railing(m)
    bicycle(-1.95, QUAY_Y + 0.42, m)
    reeds(m, rng)
    street_wires(m)
    tram(m, frames)
    bouncing_ball(m, frames)
    boat(m, frames)
    balloon(5, (-10.6, 22.0, 7.4), ("red", "ivory"), m, frames)
    balloon(6, (5.3, 24.0, 8.9), ("yellow", "teal"), m, frames)
    lantern_post(7, -3.6, -0.9, m, frames, 0.4)
    lantern_post(8, 3.4, -0.4, m, frames, 2.2)
    bunting(9, (-3.6, -0.9, 2.95), (-1.6, STREET_Y + 1.1, 3.45), m, frames)
    bunting(10, (-1.6, STREET_Y + 1.1, 3.45), (3.4, -0.4, 2.95), m, frames)
    bpy.context.scene.camera = camera(frames)
    light()


def configure(size: tuple[int, int], samples: int, frames: int, denoise: bool) -> None:
    """Cycles, the passes, and one multilayer EXR a frame."""
    scene = bpy.context.scene
    scene.render.engine, scene.render.fps = "CYCLES", FPS
    scene.render.resolution_x, scene.render.resolution_y = size
    scene.frame_start, scene.frame_end = 1, frames
    scene.cycles.samples, scene.cycles.max_bounces = samples, 6
    scene.cycles.use_adaptive_sampling, scene.cycles.use_animated_seed = False, True
    scene.cycles.use_denoising = denoise
    scene.cycles.caustics_reflective = scene.cycles.caustics_refractive = False
    scene.cycles.sample_clamp_indirect = 6.0
    for name in PASSES:
        setattr(scene.view_layers[0], f"use_pass_{name}", True)
    settings = scene.render.image_settings
    if hasattr(settings, "media_type"):
        settings.media_type = "MULTI_LAYER_IMAGE"
    settings.file_format, settings.exr_codec, settings.color_depth = "OPEN_EXR_MULTILAYER", "ZIP", "16"


def shot(size: tuple[int, int], frames: list[int]) -> dict[str, object]:
    """The camera per frame in Blender's convention: it looks down -z, +y up; metres and millimetres."""
    scene = bpy.context.scene
    rows = []
    for frame in frames:
        scene.frame_set(frame)
        matrix = [list(row) for row in scene.camera.matrix_world]
        rows.append(
            {
                "frame": frame,
                "camera_to_world": matrix,
                "lens_mm": scene.camera.data.lens,
                "sensor_mm": scene.camera.data.sensor_width,
            }
        )
    clip = {"clip_start": round(scene.camera.data.clip_start, 6), "clip_end": scene.camera.data.clip_end}
    return {"scene": "harbour", "size": list(size), "fps": FPS, **clip, "frames": rows}


def main(arguments: list[str]) -> None:
    """Render what is missing in OUT."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("out", type=Path)
    parser.add_argument("--frames", type=int, default=17, help="length of the shot")
    parser.add_argument("--only", type=int, nargs="*", help="render these frames alone")
    parser.add_argument("--size", default="480x270", help="width x height in pixels")
    parser.add_argument("--samples", type=int, default=48)
    parser.add_argument(
        "--denoise", action=argparse.BooleanOptionalAction, default=True, help="off: for builds without"
    )
    options = parser.parse_args(arguments)
    width, height = (int(n) for n in options.size.split("x"))
    build(options.frames)
    configure((width, height), options.samples, options.frames, options.denoise)
    out, frames = options.out.resolve(), options.only or list(range(1, options.frames + 1))
    out.mkdir(parents=True, exist_ok=True)
    (out / "shot.json").write_text(
        json.dumps(shot((width, height), list(range(1, options.frames + 1))), indent=1) + "\n"
    )
    for frame in frames:
        path = out / f"{frame:04d}.exr"
        if path.exists():
            continue
        bpy.context.scene.frame_set(frame)
        bpy.context.scene.render.filepath = str(out / f".{frame:04d}.exr")
        bpy.ops.render.render(write_still=True)
        (out / f".{frame:04d}.exr").replace(path)


if __name__ == "__main__":
    main(sys.argv[sys.argv.index("--") + 1 :] if "--" in sys.argv else sys.argv[1:])
