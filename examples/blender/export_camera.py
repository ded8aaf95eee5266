"""Write the cameras of your own .blend as shot.json, beside the EXRs that it renders.

    blender -b file.blend -P export_camera.py -- OUT          # OUT: the folder with the EXRs

One entry per frame of the scene's range and one more at each end, also for frames that a frame step leaves out.
Nothing in the file is changed. Cameras that markers switch to are followed; the first frame of each is marked as a cut.
"""

import json
import sys
from itertools import pairwise
from pathlib import Path

import bpy


def camera(scene: bpy.types.Scene, frame: int) -> tuple[str, dict[str, object]]:
    """Name of the camera at a frame, and its entry: it looks down -z, +y up; millimetres and scene units."""
    scene.frame_set(frame)
    if scene.camera is None:
        sys.exit(f"the scene {scene.name} has no camera at frame {frame}; set one (View > Cameras) and save the file")
    seen = scene.camera.evaluated_get(bpy.context.evaluated_depsgraph_get())
    data = seen.data
    return scene.camera.name, {
        "frame": frame,
        "camera_to_world": [list(row) for row in seen.matrix_world],
        "camera": data.type,
        "lens_mm": data.lens,
        "sensor_mm": data.sensor_width,
        "sensor_height_mm": data.sensor_height,
        "sensor_fit": data.sensor_fit,
        "shift": [data.shift_x, data.shift_y],
        "ortho_scale": data.ortho_scale,
        "clip_start": data.clip_start,
        "clip_end": data.clip_end,
    }


def shot(scene: bpy.types.Scene) -> dict[str, object]:
    """The cameras of every frame, and what holds for all of them."""
    before = scene.frame_current
    entries = [camera(scene, frame) for frame in range(scene.frame_start - 1, scene.frame_end + 2)]
    scene.frame_set(before)
    frames = [entry for _, entry in entries]
    for (name, _), (following, entry) in pairwise(entries):
        entry["cut"] = name != following
    render = scene.render
    size = [round(n * render.resolution_percentage / 100) for n in (render.resolution_x, render.resolution_y)]
    aspect = [render.pixel_aspect_x, render.pixel_aspect_y]
    return {
        "scene": scene.name,
        "size": size,
        "fps": render.fps / render.fps_base,
        "pixel_aspect": aspect,
        "frames": frames,
    }


def main(out: Path) -> None:
    """Write OUT/shot.json, whole or not at all."""
    out.mkdir(parents=True, exist_ok=True)
    temporary = out / ".shot.json.part"
    temporary.write_text(json.dumps(shot(bpy.context.scene), indent=1) + "\n")
    temporary.replace(out / "shot.json")
    print(f"wrote {out / 'shot.json'}")


if __name__ == "__main__":
    arguments = sys.argv[sys.argv.index("--") + 1 :] if "--" in sys.argv else sys.argv[1:]
    if len(arguments) != 1:
        sys.exit("say where to: blender -b file.blend -P export_camera.py -- OUT")
    main(Path(arguments[0]))
