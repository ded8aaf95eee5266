// Shared by all passes that draw meshes: the view, the instances, the material, and what a vertex is.

struct View {
    jitter: vec2f,      // clip-space offset times w; minus the sample's offset from the pixel centre
    lod_bias: f32,      // log2(render size / display size)
    sharpen: f32,       // largest further bias where a texture is seen at a slant; 0: the sampler is anisotropic itself
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

override MASK = false;          // alpha-tested
override CLIP = false;          // seen in a mirror
override BASE = false;          // which textures there are
override BUMPS = false;
override SURFACE = false;
override GLOW = false;

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

// What the textures say of a surface; 1, or straight up, where there is none.
struct Texels {
    base: vec4f,
    normal: vec3f,
    roughness: f32,
    metallic: f32,
    emissive: vec3f,
};

// A sampler that is not anisotropic takes the level of the long side of a pixel's footprint; this goes down to that of its
// short side. Only for pictures of which many are averaged: they resolve the long side.
fn bias_at(uv: vec2f, size: vec2u) -> f32 {
    let dx = dpdx(uv) * vec2f(size);
    let dy = dpdy(uv) * vec2f(size);
    let long2 = max(dot(dx, dx), dot(dy, dy));
    let area = abs(dx.x * dy.y - dx.y * dy.x);
    return view.lod_bias - clamp(log2(long2 / max(area, 1e-12)), 0.0, view.sharpen);
}

fn texels(uv: vec2f) -> Texels {
    var t = Texels(vec4f(1.0), vec3f(0.0, 0.0, 1.0), 1.0, 1.0, vec3f(1.0));
    let bias = bias_at(uv, select(textureDimensions(normal_map), textureDimensions(base_map), BASE));
    if (BASE) {
        t.base = textureSampleBias(base_map, base_sampler, uv, bias);
    }
    if (BUMPS) {
        t.normal = textureSampleBias(normal_map, normal_sampler, uv, bias).xyz * 2.0 - 1.0;
    }
    if (SURFACE) {
        let surface = textureSampleBias(surface_map, surface_sampler, uv, bias);
        t.roughness = surface.g;
        t.metallic = surface.b;
    }
    if (GLOW) {
        t.emissive = textureSampleBias(emissive_map, emissive_sampler, uv, bias).rgb;
    }
    t.base *= material.base;
    t.roughness = clamp(t.roughness * material.roughness, 0.0, 1.0);
    t.metallic = clamp(t.metallic * material.metallic, 0.0, 1.0);
    t.emissive = min(t.emissive * material.emissive, vec3f(6e4));
    return t;
}

// A tangent-space normal in the world; `side` is -1 on the back of a surface.
fn bent(n: vec3f, tangent: vec4f, local: vec3f, side: f32) -> vec3f {
    if (!BUMPS) {
        return n;
    }
    let t = normalize(tangent.xyz - n * dot(n, tangent.xyz));
    let b = cross(n, t) * tangent.w * side;
    return normalize(t * local.x * material.normal_scale + b * local.y * material.normal_scale + n * max(local.z, 0.05));
}
