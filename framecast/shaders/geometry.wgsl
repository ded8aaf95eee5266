// Shared by all passes that draw meshes: the view, the instances, the material, and what a vertex is.

struct View {
    jitter: vec2f,      // clip-space offset times w; minus the sample's offset from the pixel centre
    lod_bias: f32,      // log2(render size / display size)
    size: f32,          // unused
    eye: vec4f,
    plane: vec4f,       // world points p with dot(plane, (p, 1)) < 0 are cut away where CLIP is set
};

struct Instance {
    model: mat4x4f,     // to the world
    clip: mat4x4f,      // to clip space, unjittered; premultiplied in double precision
    object: u32,
    mirror: u32,        // 0: none, k + 1: lies in mirror k
    pad: vec2u,
};

struct Material {
    base: vec4f,
    emissive: vec3f,
    normal_scale: f32,
    roughness: f32,
    metallic: f32,
    cutoff: f32,
    pad: f32,
};

override MASK = false;
override CLIP = false;

@group(0) @binding(0) var<uniform> view: View;
@group(0) @binding(1) var<storage, read> instances: array<Instance>;

@group(1) @binding(0) var<uniform> material: Material;
@group(1) @binding(1) var base_map: texture_2d<f32>;
@group(1) @binding(2) var normal_map: texture_2d<f32>;
@group(1) @binding(3) var surface_map: texture_2d<f32>;
@group(1) @binding(4) var emissive_map: texture_2d<f32>;
@group(1) @binding(5) var base_sampler: sampler;
@group(1) @binding(6) var normal_sampler: sampler;
@group(1) @binding(7) var surface_sampler: sampler;
@group(1) @binding(8) var emissive_sampler: sampler;

// Takes normals along with a model matrix, whatever its scale, mirrored or not.
fn turn_normal(model: mat4x4f, n: vec3f) -> vec3f {
    let x = model[0].xyz;
    let y = model[1].xyz;
    let z = model[2].xyz;
    let turned = cross(y, z) * n.x + cross(z, x) * n.y + cross(x, y) * n.z;
    return normalize(turned) * sign(dot(cross(x, y), z));
}

// Octahedral: a unit vector in two numbers in [-1, 1].
fn fold(n: vec3f) -> vec2f {
    let p = n.xy / (abs(n.x) + abs(n.y) + abs(n.z));
    let around = (1.0 - abs(p.yx)) * select(vec2f(-1.0), vec2f(1.0), p >= vec2f(0.0));
    return select(p, around, n.z < 0.0);
}
