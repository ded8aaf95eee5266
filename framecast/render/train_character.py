"""A walking person made in code: 15 joints, skinned limbs and clothes, and a walk whose feet do not slide.

The person stands on y = 0 at the origin, looks along +z and is about 1.75 m tall. Used by training scenes only.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from numpy.random import Generator

from framecast.render.finish import plain
from framecast.render.mesh import join, placed
from framecast.render.motion import Numbers, move, scale, turn
from framecast.render.scene import Instance, Material, Mesh, Pose
from framecast.render.train_shapes import ball, box, tube

JOINTS: dict[str, tuple[str, tuple[float, float, float]]] = {
    "hips": ("", (0, 0.95, 0)),
    "chest": ("hips", (0, 1.20, 0)),
    "head": ("chest", (0, 1.50, 0)),
    **{
        f"{name}_{side}": (parent if parent in ("hips", "chest") else f"{parent}_{side}", (x * sign, y, z))
        for side, sign in (("left", 1), ("right", -1))
        for name, parent, x, y, z in (
            ("thigh", "hips", 0.10, 0.92, 0.0),
            ("shin", "thigh", 0.10, 0.50, 0.01),
            ("foot", "shin", 0.10, 0.09, -0.01),
            ("arm", "chest", 0.20, 1.41, 0.0),
            ("forearm", "arm", 0.235, 1.13, 0.0),
            ("hand", "forearm", 0.245, 0.88, 0.03),
        )
    },
}
"""Joint name -> (parent, rest position)."""
ORDER = list(JOINTS)
THIGH, SHIN = 0.42, 0.41
STRIDE = 1.1
"""Metres per full cycle of two steps."""


def skinned(mesh: Mesh, chain: Sequence[str], axis: int = 1, soft: float = 0.07) -> Mesh:
    """The mesh bound to a chain of joints listed from the top down (at most four),
    blended over ±`soft` m at each joint.
    """
    heights = [JOINTS[name][1][axis] for name in chain[1:]]
    y = mesh.positions[:, axis]
    below = [np.clip((h + soft - y) / (2 * soft), 0, 1) for h in heights]
    below = [b * b * (3 - 2 * b) for b in below]
    weights = np.zeros((len(y), 4), np.float32)
    rest = np.ones(len(y))
    for k, b in enumerate(below):
        weights[:, k] = rest * (1 - b)
        rest = rest * b
    weights[:, len(chain) - 1] = rest
    joints = np.zeros((len(y), 4), np.uint16)
    joints[:, : len(chain)] = [ORDER.index(name) for name in chain]
    return replace(mesh, joints=joints, weights=weights)


def bound(meshes: Sequence[Mesh]) -> Mesh:
    """Skinned meshes joined into one, skins kept."""
    joints = np.concatenate([mesh.joints for mesh in meshes if mesh.joints is not None])
    weights = np.concatenate([mesh.weights for mesh in meshes if mesh.weights is not None])
    return replace(join(meshes), joints=joints, weights=weights)


def limb(stations: Numbers, sides: int = 14) -> Mesh:
    """A rounded limb through (x, y, z, radius) stations, resampled smoothly."""
    knots = np.asarray(stations, np.float64)
    t, fine = np.linspace(0, 1, len(knots)), np.linspace(0, 1, 6 * len(knots))
    path = np.stack([np.interp(fine, t, knots[:, k]) for k in range(4)], axis=1)
    kernel = np.ones(5) / 5
    inner = np.stack([np.convolve(np.pad(path[:, k], 2, mode="edge"), kernel, "valid") for k in range(4)], axis=1)
    inner[0], inner[-1] = path[0], path[-1]
    return tube(inner[:, :3], inner[:, 3], sides, 0.3)


def clothes() -> dict[str, Mesh]:
    """Skinned parts of the rest pose by material: skin, top, trousers, shoes, hair."""
    parts: dict[str, list[Mesh]] = {name: [] for name in ("skin", "top", "trousers", "shoes", "hair")}
    torso = limb(
        [
            (0, 1.47, 0, 0.07),
            (0, 1.44, 0, 0.13),
            (0, 1.36, 0, 0.165),
            (0, 1.25, 0, 0.165),
            (0, 1.10, 0, 0.145),
            (0, 0.97, 0, 0.165),
            (0, 0.86, 0, 0.17),
            (0, 0.84, 0, 0.16),
        ],
        22,
    )
    parts["top"].append(skinned(placed(torso, scale(1.12, 1, 0.74)), ("chest", "hips")))
    pelvis = placed(limb([(0, 1.0, 0, 0.12), (0, 0.92, 0, 0.155), (0, 0.84, 0, 0.13)], 18), scale(1.1, 1, 0.75))
    parts["trousers"].append(skinned(pelvis, ("hips",)))
    neck = limb([(0, 1.42, 0, 0.06), (0, 1.5, 0.005, 0.055), (0, 1.57, 0.015, 0.06)], 12)
    face = placed(ball(0.1, 24), move(0, 1.635, 0.02), scale(0.84, 1.2, 0.98))
    nose = placed(ball(0.018, 8), move(0, 1.62, 0.118))
    parts["skin"] += [skinned(part, ("head",)) for part in (neck, face, nose)]
    cap = placed(ball(0.108, 24), move(0, 1.675, 0.0), scale(0.86, 1.02, 0.98))
    parts["hair"].append(skinned(cap, ("head",)))
    for side, s in (("left", 1), ("right", -1)):
        leg = limb(
            [
                (0.1 * s, 0.93, 0, 0.095),
                (0.1 * s, 0.75, 0, 0.088),
                (0.1 * s, 0.5, 0.01, 0.066),
                (0.1 * s, 0.35, -0.005, 0.064),
                (0.1 * s, 0.1, -0.01, 0.056),
            ]
        )
        parts["trousers"].append(skinned(leg, (f"thigh_{side}", f"shin_{side}")))
        shoe = placed(
            limb(
                [
                    (0, 0, -0.085, 0.035),
                    (0, 0, -0.04, 0.052),
                    (0, 0, 0.06, 0.046),
                    (0, 0, 0.15, 0.045),
                    (0, 0, 0.18, 0.03),
                ],
                12,
            ),
            move(0.1 * s, 0.045, 0),
            scale(0.95, 0.85, 1),
        )
        sole = placed(box(0.09, 0.03, 0.28, 0.012), move(0.1 * s, 0.015, 0.045))
        parts["shoes"] += [skinned(shoe, (f"foot_{side}",)), skinned(sole, (f"foot_{side}",))]
        sleeve = limb(
            [
                (0.17 * s, 1.43, 0, 0.06),
                (0.205 * s, 1.39, 0, 0.066),
                (0.22 * s, 1.26, 0, 0.056),
                (0.235 * s, 1.13, 0, 0.047),
                (0.242 * s, 1.0, 0.015, 0.043),
                (0.245 * s, 0.92, 0.025, 0.040),
            ]
        )
        parts["top"].append(skinned(sleeve, (f"arm_{side}", f"forearm_{side}")))
        hand = limb(
            [
                (0.245 * s, 0.93, 0.02, 0.026),
                (0.247 * s, 0.87, 0.03, 0.038),
                (0.245 * s, 0.80, 0.045, 0.032),
                (0.24 * s, 0.765, 0.055, 0.016),
            ],
            10,
        )
        parts["skin"].append(skinned(hand, (f"forearm_{side}", f"hand_{side}")))
    return {name: bound(meshes) for name, meshes in parts.items()}


def walk_joints(distance: float) -> Float[ndarray, "j 4 4"]:
    """Joint matrices (pose @ inverse rest) after walking `distance` metres along +z, the body kept at the origin.

    The ankles follow a path fixed in the ground while they stand, and the knees follow from the two bones' lengths.
    """
    phase = distance / STRIDE
    swing = 2 * np.pi * phase
    local = {name: np.eye(4) for name in ORDER}
    bob = -0.045 - 0.03 * np.cos(2 * swing)
    local["hips"] = move(0.02 * np.sin(swing), bob, 0) @ turn("y", 0.10 * np.sin(swing))
    local["chest"] = turn("y", -0.22 * np.sin(swing)) @ turn("x", 0.05)
    local["head"] = turn("y", 0.12 * np.sin(swing)) @ turn("x", -0.03)
    for side, offset, sign in (("left", 0.0, 1.0), ("right", 0.5, -1.0)):
        thigh, knee, foot = leg_angles((phase + offset) % 1.0, bob)
        local[f"thigh_{side}"] = turn("y", -0.10 * np.sin(swing)) @ turn("x", thigh)
        local[f"shin_{side}"] = turn("x", knee)
        local[f"foot_{side}"] = turn("x", foot - thigh - knee)
        forth = sign * np.sin(swing + 0.2)
        local[f"arm_{side}"] = turn("x", 0.48 * forth) @ turn("z", 0.07 * sign)
        local[f"forearm_{side}"] = turn("x", -0.30 - 0.25 * max(0.0, -forth))
    world: dict[str, ndarray] = {}
    for name, (parent, rest) in JOINTS.items():
        here = move(*rest) @ local[name] @ move(*(-np.asarray(rest)))
        world[name] = world[parent] @ here if parent else here
    return np.stack([world[name] for name in ORDER])


def leg_angles(phase: float, bob: float) -> tuple[float, float, float]:
    """(thigh, knee, foot pitch) about +x in radians;
    the foot stands for phase 0..0.6 and swings forward for the rest.
    """
    stand, reach = 0.6, 0.6 * STRIDE / 2
    if phase < stand:
        z, lift, pitch = (
            reach - phase * STRIDE,
            0.0,
            -0.30 * max(0.0, 1 - phase / 0.1) + 0.5 * max(0.0, phase - 0.45) / 0.15,
        )
        lift = 0.07 * max(0.0, (phase - 0.45) / 0.15) ** 2
    else:
        t = (phase - stand) / (1 - stand)
        z = -reach + 2 * reach * t * t * (3 - 2 * t)
        lift, pitch = 0.07 * (1 - t) ** 2 + 0.10 * np.sin(np.pi * t), 0.5 * (1 - t) ** 2 - 0.30 * t * t
    down = 0.92 + bob - 0.09 - lift
    far = min(float(np.hypot(z, down)), THIGH + SHIN - 1e-4)
    knee = np.pi - np.arccos((THIGH**2 + SHIN**2 - far**2) / (2 * THIGH * SHIN))
    inner = np.arccos((THIGH**2 + far**2 - SHIN**2) / (2 * THIGH * far))
    thigh = -np.arctan2(z, down) - inner
    return float(thigh), float(knee), float(pitch)


def walker(
    rng: Generator,
    number: int,
    path: Callable[[float], tuple[Float[ndarray, "4 4"], float]],
    palette: Sequence[Material],
) -> list[Instance]:
    """Instances of one person with object id `number`; `path(time)` gives where it stands and the metres walked so far.

    `palette` has the materials of top, trousers and shoes; skin and hair are drawn from `rng`.
    """
    skin = plain(np.array([0.93, 0.74, 0.62]) * rng.uniform(0.45, 1.0), 0.5)
    hair = plain(np.array([0.35, 0.24, 0.16]) * rng.uniform(0.3, 1.4), 0.6)
    materials = dict(zip(("top", "trousers", "shoes"), palette, strict=True)) | {"skin": skin, "hair": hair}

    def pose(time: float) -> Pose:
        place, walked = path(time)
        return Pose(np.eye(4), joints=place @ walk_joints(walked))

    return [Instance(mesh, materials[name], number, pose) for name, mesh in clothes().items()]
