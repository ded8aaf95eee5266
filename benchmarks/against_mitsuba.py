"""The renderer against Mitsuba 3, an independent path tracer: the same small scene, the same units and conventions?

A ball of rough metal and a diffuse one over a diffuse floor, a sun and a uniform sky, seen by a rolled camera.
Needs `pip install mitsuba`. Prints agreement of depth, normal and displayed colour.

    python benchmarks/against_mitsuba.py
"""

import mitsuba as mi
import numpy as np
import torch

from framecast.color import to_display
from framecast.render import reference
from framecast.render.renderer import Renderer
from framecast.render.scene import Camera, Instance, Light, LightPose, Material, Mesh, Pose, Scene, Sky

SIZE, FOV = (180, 320), 0.7
SUN, SKY = 2.0, 0.5
DIRECTION = np.array([0.5, -0.8, -0.4]) / np.linalg.norm([0.5, -0.8, -0.4])
BALLS = ((-0.9, (0.8, 0.3, 0.2), False), (0.9, (0.9, 0.7, 0.4), True))
"""x, colour, metal; radius 0.8, roughness 0.5."""


def camera() -> np.ndarray:
    """Camera to world: behind, above, looking down, rolled."""
    pitch, roll = -0.35, 0.15
    turn = np.array([[1, 0, 0], [0, np.cos(pitch), -np.sin(pitch)], [0, np.sin(pitch), np.cos(pitch)]])
    about = np.array([[np.cos(roll), -np.sin(roll), 0], [np.sin(roll), np.cos(roll), 0], [0, 0, 1]])
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = turn @ about, (0.2, 2.4, 5)
    return matrix


def ball(rings: int = 96) -> Mesh:
    polar, azimuth = np.meshgrid(
        np.linspace(0, np.pi, rings + 1), np.linspace(0, 2 * np.pi, 2 * rings + 1), indexing="ij"
    )
    axes = np.sin(polar) * np.sin(azimuth), np.cos(polar), np.sin(polar) * np.cos(azimuth)
    points, row = np.stack(axes, -1).reshape(-1, 3), 2 * rings + 1
    first = (np.arange(rings)[:, None] * row + np.arange(2 * rings)).reshape(-1)
    corners = [first, first + row, first + row + 1, first, first + row + 1, first + 1]
    return Mesh(points, points, points[:, :2], np.stack(corners, 1).reshape(-1))


def ours() -> Scene:
    """The scene for this package."""
    corners = np.array([[-9.0, 0, -9], [-9, 0, 9], [9, 0, 9], [9, 0, -9]])
    floor = Mesh(corners, np.tile([0.0, 1, 0], (4, 1)), corners[:, ::2], np.array([0, 1, 2, 0, 2, 3]))

    def placed(x: float) -> Pose:
        matrix = np.diag([0.8, 0.8, 0.8, 1])
        matrix[:3, 3] = x, 0.8, 0
        return Pose(matrix)

    balls = [
        Instance(ball(), Material((*color, 1), roughness=0.5 if metal else 1.0, metallic=float(metal)), 0,
                 lambda time, x=x: placed(x))
        for x, color, metal in BALLS
    ]  # fmt: skip
    sun = Light("sun", (1, 1, 1), SUN, lambda time: LightPose(np.zeros(3), DIRECTION))
    sky = Sky(np.full((8, 16, 3), SKY, np.float32), sun_disc=False)
    ground = Instance(floor, Material((0.5, 0.5, 0.5, 1)))
    return Scene("mitsuba", (ground, *balls), (sun,), Camera(lambda time: camera(), FOV), sky)


def theirs() -> "mi.Scene":
    """The same for Mitsuba, made of analytic shapes; its camera looks along +z with x to the left."""
    look = camera() @ np.diag([-1.0, 1, -1, 1])
    sensor = {
        "type": "perspective", "fov": float(np.degrees(FOV)), "fov_axis": "y", "to_world": mi.ScalarTransform4f(look),
        "film": {"type": "hdrfilm", "width": SIZE[1], "height": SIZE[0], "rfilter": {"type": "box"}},
        "sampler": {"type": "independent", "sample_count": 400},
    }  # fmt: skip
    to_floor = mi.ScalarTransform4f().rotate([1, 0, 0], -90).scale(9)
    parts = {
        "type": "scene", "sensor": sensor,
        "integrator": {"type": "aov", "aovs": "p:position,n:sh_normal", "image": {"type": "path", "max_depth": 8}},
        "sky": {"type": "constant", "radiance": {"type": "rgb", "value": SKY}},
        "sun": {"type": "directional", "direction": DIRECTION.tolist(), "irradiance": {"type": "rgb", "value": SUN}},
        "floor": {"type": "rectangle", "to_world": to_floor, "bsdf": diffuse((0.5, 0.5, 0.5))},
    }  # fmt: skip
    for index, (x, color, metal) in enumerate(BALLS):
        rough = {"type": "roughconductor", "distribution": "ggx", "alpha": 0.25, "material": "none",
                 "specular_reflectance": {"type": "rgb", "value": color}}  # fmt: skip
        parts[f"ball{index}"] = {
            "type": "sphere", "center": [x, 0.8, 0], "radius": 0.8, "bsdf": rough if metal else diffuse(color),
        }  # fmt: skip
    return mi.load_dict(parts)


def diffuse(color: tuple[float, float, float]) -> dict:
    return {"type": "diffuse", "reflectance": {"type": "rgb", "value": list(color)}}


def main() -> None:
    mi.set_variant("scalar_rgb")
    image = np.array(mi.render(theirs()))
    color, position, normal = image[..., :3], image[..., -6:-3], image[..., -3:]
    scene = ours()
    renderer = Renderer(scene)
    frame = renderer.frame(0.0, SIZE)
    mine = reference.reference(renderer, 0.0, SIZE, 64).color
    depth = -((position - camera()[:3, 3]) @ camera()[:3, :3])[..., 2]
    flat = (frame["depth"][0] < 60000) & (np.abs(np.linalg.norm(normal, axis=-1) - 1) < 1e-3)
    print(f"smooth pixels                  {100 * flat.mean():.1f} %")
    print(f"depth, median relative error   {np.median(np.abs(frame['depth'][0] / depth - 1)[flat]):.1e}")
    angle = np.degrees(np.arccos(np.clip((frame["normal"].transpose(1, 2, 0) * normal).sum(-1)[flat], -1, 1)))
    print(f"normal, median angle           {np.median(angle):.3f} degrees")
    shown = [
        to_display(torch.from_numpy(np.ascontiguousarray(c, np.float32))) for c in (mine, color.transpose(2, 0, 1))
    ]
    error = (shown[0] - shown[1]).abs().mean(0).numpy()
    print(f"displayed colour, PSNR         {-10 * np.log10(float(((shown[0] - shown[1]) ** 2).mean())):.1f} dB")
    print(f"displayed colour, mean error   {error.mean():.4f}")
    both = (torch.cat(shown, 2).permute(1, 2, 0).numpy() * 255 + 0.5).astype(np.uint8)
    mi.Bitmap(both).write("against_mitsuba.png")


if __name__ == "__main__":
    main()
