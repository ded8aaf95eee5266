"""Meshes and procedural materials for `demo_scene.py`.

A shape is `(vertices, faces)`: points in metres and lists of indices into them. Functions here make and join shapes;
`add` turns one into a Blender object with texture coordinates in metres, so that a brick is a brick on every wall.
"""

import math
from collections.abc import Callable, Sequence

import bmesh
import bpy
from mathutils import Matrix, Vector

Shape = tuple[list[Vector], list[list[int]]]
Color = tuple[float, float, float]
Point = tuple[float, float, float]


def join(*shapes: Shape) -> Shape:
    """All shapes as one."""
    vertices: list[Vector] = []
    faces: list[list[int]] = []
    for points, polygons in shapes:
        faces += [[i + len(vertices) for i in polygon] for polygon in polygons]
        vertices += points
    return vertices, faces


def moved(shape: Shape, matrix: Matrix) -> Shape:
    """The shape under an affine map."""
    return [matrix @ v for v in shape[0]], shape[1]


def at(shape: Shape, x: float, y: float, z: float) -> Shape:
    """The shape shifted."""
    return moved(shape, Matrix.Translation((x, y, z)))


def turned(shape: Shape, degrees: float, axis: str) -> Shape:
    """The shape rotated about an axis through the origin."""
    return moved(shape, Matrix.Rotation(math.radians(degrees), 4, axis))


def box(centre: Point, size: Point) -> Shape:
    """Axis-aligned box."""
    return prism([(-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5)], centre, size)


def prism(outline: Sequence[tuple[float, float]], centre: Point, size: Point) -> Shape:
    """Outline in x, z (counter-clockwise), extruded along y from -0.5 to 0.5; then scaled by `size` and shifted."""
    n = len(outline)
    points = [Vector((x, y, z)) for y in (-0.5, 0.5) for x, z in outline]
    sides = [[i, (i + 1) % n, n + (i + 1) % n, n + i] for i in range(n)]
    faces = [list(range(n - 1, -1, -1)), list(range(n, 2 * n)), *sides]
    scaled = [Vector((p.x * size[0], p.y * size[1], p.z * size[2])) + Vector(centre) for p in points]
    return scaled, [face[::-1] for face in faces]


def lathe(profile: Sequence[tuple[float, float]], segments: int = 24) -> Shape:
    """Profile of (radius, z), bottom to top, turned about z. Open at the ends unless the radius reaches 0 there."""
    points = [
        Vector((r * math.cos(a), r * math.sin(a), z))
        for r, z in profile
        for a in (2 * math.pi * k / segments for k in range(segments))
    ]
    faces = []
    for row in range(len(profile) - 1):
        for k in range(segments):
            a, b = row * segments + k, row * segments + (k + 1) % segments
            faces.append([a, b, b + segments, a + segments])
    return points, faces


def tube(path: Sequence[Point], radius: float, segments: int = 8) -> Shape:
    """Round bar along a path."""
    points: list[Vector] = []
    path_ = [Vector(p) for p in path]
    for i, p in enumerate(path_):
        along = (path_[min(i + 1, len(path_) - 1)] - path_[max(i - 1, 0)]).normalized()
        side = along.orthogonal().normalized()
        if i and side.dot(points[-segments] - path_[i - 1]) < 0:
            side = -side
        up = along.cross(side)
        angles = (2 * math.pi * k / segments for k in range(segments))
        points += [p + radius * (math.cos(a) * side + math.sin(a) * up) for a in angles]
    faces = []
    for row in range(len(path_) - 1):
        for k in range(segments):
            a, b = row * segments + k, row * segments + (k + 1) % segments
            faces.append([a, b, b + segments, a + segments])
    ends = [list(range(segments))[::-1], list(range(len(points) - segments, len(points)))]
    return points, faces + ends


def ring(radius: float, thickness: float, segments: int = 32) -> Shape:
    """Torus in the x, z plane."""
    circle = [2 * math.pi * k / segments for k in range(segments + 1)]
    return tube([(radius * math.cos(a), 0, radius * math.sin(a)) for a in circle], thickness, 6)


def ball(radius: float, segments: int = 24) -> Shape:
    """Sphere about the origin."""
    rings = segments // 2
    angles = [math.pi * (k / rings - 0.5) for k in range(rings + 1)]
    return lathe([(max(radius * math.cos(a), 1e-4), radius * math.sin(a)) for a in angles], segments)


def sagging(start: Point, end: Point, sag: float, count: int = 13) -> list[Point]:
    """Points of a wire hung between two points."""
    a, b = Vector(start), Vector(end)
    steps = (k / (count - 1) for k in range(count))
    return [tuple(a.lerp(b, s) - Vector((0, 0, 4 * sag * s * (1 - s)))) for s in steps]


def add(
    name: str,
    shape: Shape,
    materials: bpy.types.Material | Sequence[bpy.types.Material],
    *,
    bevel: float = 0.0,
    smooth: bool = False,
    pick: Callable[[Vector], int] | None = None,
) -> bpy.types.Object:
    """Blender object of a shape, textured by box projection. `pick`: material of a face by its centre."""
    data = bpy.data.meshes.new(name)
    data.from_pydata(shape[0], [], shape[1])
    for one in materials if isinstance(materials, Sequence) else [materials]:
        data.materials.append(one)
    graph = bmesh.new()
    graph.from_mesh(data)
    bmesh.ops.recalc_face_normals(graph, faces=graph.faces)
    layer = graph.loops.layers.uv.new("metres")
    for face in graph.faces:
        face.smooth = smooth
        face.material_index = pick(face.calc_center_median()) if pick else 0
        axis = max(range(3), key=lambda i: abs(face.normal[i]))
        u, v = {0: (1, 2), 1: (0, 2), 2: (0, 1)}[axis]
        for loop in face.loops:
            loop[layer].uv = (loop.vert.co[u], loop.vert.co[v])
    graph.to_mesh(data)
    graph.free()
    made = bpy.data.objects.new(name, data)
    bpy.context.scene.collection.objects.link(made)
    if bevel:
        modifier = made.modifiers.new("bevel", "BEVEL")
        modifier.width, modifier.segments, modifier.limit_method = bevel, 2, "ANGLE"
    return made


# Materials. Colours are linear Rec.709.


def paint(name: str, color: Color, roughness: float = 0.5, metallic: float = 0.0, glow: float = 0.0):
    """One colour; `glow` adds emission of that colour."""
    made = bpy.data.materials.new(name)
    made.use_nodes = True
    shader = made.node_tree.nodes["Principled BSDF"]
    shader.inputs["Base Color"].default_value = (*color, 1)
    shader.inputs["Roughness"].default_value = roughness
    shader.inputs["Metallic"].default_value = metallic
    emission = shader.inputs["Emission Color" if "Emission Color" in shader.inputs else "Emission"]
    emission.default_value = (*color, 1)
    shader.inputs["Emission Strength"].default_value = glow
    return made


def cloth(name: str, color: Color) -> bpy.types.Material:
    """Thin cloth, lit alike from both sides: half of the light passes through."""
    made = bpy.data.materials.new(name)
    made.use_nodes = True
    tree = made.node_tree
    tree.nodes.clear()
    kinds = ("ShaderNodeBsdfDiffuse", "ShaderNodeBsdfTranslucent", "ShaderNodeMixShader", "ShaderNodeOutputMaterial")
    front, through, mix, out = (tree.nodes.new(kind) for kind in kinds)
    for k, shader in enumerate((front, through)):
        shader.inputs["Color"].default_value = (*color, 1)
        tree.links.new(shader.outputs[0], mix.inputs[1 + k])
    tree.links.new(mix.outputs[0], out.inputs["Surface"])
    return made


def _noise(tree: bpy.types.NodeTree, scale: float, stretch: Point = (1, 1, 1)) -> bpy.types.NodeSocket:
    mapping, coordinates = tree.nodes.new("ShaderNodeMapping"), tree.nodes.new("ShaderNodeTexCoord")
    mapping.inputs["Scale"].default_value = stretch
    noise = tree.nodes.new("ShaderNodeTexNoise")
    noise.inputs["Scale"].default_value = scale
    noise.inputs["Detail"].default_value = 4
    tree.links.new(coordinates.outputs["UV"], mapping.inputs["Vector"])
    tree.links.new(mapping.outputs["Vector"], noise.inputs["Vector"])
    return noise.outputs["Fac"] if "Fac" in noise.outputs else noise.outputs[0]


def _mottle(tree: bpy.types.NodeTree, color: bpy.types.NodeSocket, fac: bpy.types.NodeSocket, amount: float):
    """Colour times 1 ± amount, by a noise of 0..1."""
    ramp, mix = tree.nodes.new("ShaderNodeMapRange"), tree.nodes.new("ShaderNodeVectorMath")
    ramp.inputs["From Min"].default_value, ramp.inputs["From Max"].default_value = 0.3, 0.7
    ramp.inputs["To Min"].default_value, ramp.inputs["To Max"].default_value = 1 - amount, 1 + amount
    mix.operation = "SCALE"
    tree.links.new(fac, ramp.inputs["Value"])
    tree.links.new(color, mix.inputs[0])
    tree.links.new(ramp.outputs[0], mix.inputs["Scale"])
    return mix.outputs[0]


def _bump(tree: bpy.types.NodeTree, height: bpy.types.NodeSocket, strength: float, distance: float = 0.02) -> None:
    bump = tree.nodes.new("ShaderNodeBump")
    bump.inputs["Strength"].default_value, bump.inputs["Distance"].default_value = strength, distance
    tree.links.new(height, bump.inputs["Height"])
    tree.links.new(bump.outputs[0], tree.nodes["Principled BSDF"].inputs["Normal"])


def masonry(
    name: str,
    colors: tuple[Color, Color, Color],
    size: tuple[float, float],
    *,
    gap: float = 0.012,
    roughness: float = 0.8,
    grain: Point = (1, 1, 1),
) -> bpy.types.Material:
    """Bricks, tiles, slabs or planks of `size` metres in two colours with a third in the gaps."""
    made = paint(name, colors[0], roughness)
    tree = made.node_tree
    brick, coordinates = tree.nodes.new("ShaderNodeTexBrick"), tree.nodes.new("ShaderNodeTexCoord")
    for key, color in zip(("Color1", "Color2", "Mortar"), colors, strict=True):
        brick.inputs[key].default_value = (*color, 1)
    settings = {"Scale": 1.0, "Brick Width": size[0], "Row Height": size[1], "Mortar Size": gap, "Mortar Smooth": 0.1}
    for key, value in settings.items():
        brick.inputs[key].default_value = value
    tree.links.new(coordinates.outputs["UV"], brick.inputs["Vector"])
    color = _mottle(tree, brick.outputs["Color"], _noise(tree, 6.0, grain), 0.3)
    tree.links.new(color, tree.nodes["Principled BSDF"].inputs["Base Color"])
    flip = tree.nodes.new("ShaderNodeMath")
    flip.operation = "SUBTRACT"
    flip.inputs[0].default_value = 1.0
    tree.links.new(brick.outputs["Fac"], flip.inputs[1])
    _bump(tree, flip.outputs[0], 0.5)
    return made


def plaster(name: str, color: Color) -> bpy.types.Material:
    """Uneven wall paint."""
    made = paint(name, color, 0.85)
    tree = made.node_tree
    rgb = tree.nodes.new("ShaderNodeRGB")
    rgb.outputs[0].default_value = (*color, 1)
    fac = _noise(tree, 2.5)
    tree.links.new(_mottle(tree, rgb.outputs[0], fac, 0.22), tree.nodes["Principled BSDF"].inputs["Base Color"])
    _bump(tree, _noise(tree, 30.0), 0.25)
    return made


def water(name: str, color: Color, frames: int) -> bpy.types.Material:
    """Dark glossy water whose small waves drift with time."""
    made = paint(name, color, 0.04)
    tree = made.node_tree
    noise, coordinates = tree.nodes.new("ShaderNodeTexNoise"), tree.nodes.new("ShaderNodeTexCoord")
    noise.noise_dimensions = "4D"
    noise.inputs["Scale"].default_value = 1.6
    tree.links.new(coordinates.outputs["UV"], noise.inputs["Vector"])
    for frame in (0, frames + 1):
        noise.inputs["W"].default_value = 0.02 * frame
        noise.inputs["W"].keyframe_insert("default_value", frame=frame)
    _bump(tree, noise.outputs[0], 0.14, 0.1)
    return made


def sky(stops: Sequence[tuple[float, Color]], strength: float) -> bpy.types.World:
    """World with a vertical gradient: colours at heights (sine of the elevation mapped from -1..1 to 0..1)."""
    world = bpy.data.worlds.new("sky")
    world.use_nodes = True
    tree = world.node_tree
    tree.nodes.clear()
    coordinates, split = tree.nodes.new("ShaderNodeTexCoord"), tree.nodes.new("ShaderNodeSeparateXYZ")
    height, ramp = tree.nodes.new("ShaderNodeMapRange"), tree.nodes.new("ShaderNodeValToRGB")
    background, out = tree.nodes.new("ShaderNodeBackground"), tree.nodes.new("ShaderNodeOutputWorld")
    height.inputs["From Min"].default_value = -1.0
    while len(ramp.color_ramp.elements) < len(stops):
        ramp.color_ramp.elements.new(0.5)
    for element, (position, color) in zip(ramp.color_ramp.elements, stops, strict=True):
        element.position, element.color = position, (*color, 1)
    background.inputs["Strength"].default_value = strength
    tree.links.new(coordinates.outputs["Generated"], split.inputs[0])
    tree.links.new(split.outputs["Z"], height.inputs["Value"])
    tree.links.new(height.outputs[0], ramp.inputs[0])
    tree.links.new(ramp.outputs[0], background.inputs["Color"])
    tree.links.new(background.outputs[0], out.inputs["Surface"])
    return world
