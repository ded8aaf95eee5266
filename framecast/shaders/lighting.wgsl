// Shared by all passes that light something: the lights, the sky, the mirrors' pictures, and the GGX surface model.

const PI = 3.14159265;
const SKY = 65504.0;

struct Frame {
    right: vec4f,       // world position = eye + depth * (forward + ndc.x * right + ndc.y * up)
    up: vec4f,
    forward: vec4f,
    eye: vec4f,
    size: vec2f,        // pixels
    jitter: vec2f,      // sample minus pixel centre, pixels, y down
    near: f32,
    exposure: f32,
    haze: f32,          // per scene unit
    focal: f32,         // pixels per unit of tangent
    light_count: u32,
    sun_disc: u32,
    mirrors: u32,
    ambient_occlusion: f32,  // its radius in scene units
};

struct Light {
    color: vec3f,       // times intensity
    kind: u32,          // 0 sun, 1 point, 2 spot
    position: vec3f,
    radius: f32,
    direction: vec3f,   // along which the light travels
    reach: f32,
    inner: f32,         // cosines of the cone
    outer: f32,
    shadow: u32,        // first of its shadow maps
    shadows: u32,       // how many; 0: casts none
    splits: vec4f,      // sun: view depths up to which each of its three cascades is good
};

struct ShadowMap {
    matrix: mat4x4f,    // world to clip, depth reversed
    texel: f32,         // sun: width of a texel in scene units; others: at distance 1
    range: f32,         // sun: scene units from depth 1 to depth 0; others: the near distance
    layer: u32,
    pad: u32,
};

@group(2) @binding(0) var<uniform> frame: Frame;
@group(2) @binding(1) var<storage, read> lights: array<Light>;
@group(2) @binding(2) var<storage, read> shadow_maps: array<ShadowMap>;
@group(2) @binding(3) var sun_depths: texture_depth_2d_array;
@group(2) @binding(4) var lamp_depths: texture_depth_2d_array;
@group(2) @binding(5) var shadow_sampler: sampler_comparison;
@group(2) @binding(6) var sky: texture_2d<f32>;
@group(2) @binding(7) var ambient: texture_2d<f32>;
@group(2) @binding(8) var environment: texture_2d_array<f32>;  // ROUGH blurred skies, irradiance / pi, and the GGX table
@group(2) @binding(9) var sky_sampler: sampler;
@group(2) @binding(10) var reflections: texture_2d_array<f32>;  // rgb, depth
@group(2) @binding(11) var linear_sampler: sampler;

const ROUGH = 6;

struct Surface {
    position: vec3f,
    depth: f32,
    normal: vec3f,
    geometric: vec3f,
    albedo: vec3f,
    roughness: f32,
    metallic: f32,
    emissive: vec3f,
    occlusion: f32,     // ambient occlusion, 1 = open
    mirror: u32,        // 0: none, k + 1: lies in mirror k
    pixel: vec2f,       // where the picture shows it
};

// The rotation of every sampling pattern: the same all over the picture, so there is no noise in it; it differs from
// jitter to jitter, so that a reference, the mean of many, has no pattern either.
fn pattern_angle() -> f32 {
    return (frame.jitter.x + frame.jitter.y * 0.61803) * 2.0 * PI;
}

// Points evenly spread over a disc, one after the other: `next_on_disc` turns the direction by the golden angle.
fn first_on_disc(angle: f32) -> vec2f {
    return vec2f(cos(angle), sin(angle));
}

fn next_on_disc(direction: vec2f) -> vec2f {
    return vec2f(-0.7373688 * direction.x - 0.6754903 * direction.y, 0.6754903 * direction.x - 0.7373688 * direction.y);
}

// How far out point k of n lies on the unit disc.
fn out_on_disc(k: u32, n: u32) -> f32 {
    return sqrt((f32(k) + 0.5) / f32(n));
}

// Octahedral coordinates (geometry.wgsl's `fold`) back to a unit vector.
fn unfold(p: vec2f) -> vec3f {
    let z = 1.0 - abs(p.x) - abs(p.y);
    let t = max(-z, 0.0);
    return normalize(vec3f(p + select(vec2f(t), vec2f(-t), p >= vec2f(0.0)), z));
}

// World direction through a point of the picture, in pixels; its length along the camera's axis is 1.
fn ray_through(pixel: vec2f) -> vec3f {
    let ndc = (pixel / frame.size * 2.0 - 1.0) * vec2f(1.0, -1.0);
    return frame.forward.xyz + ndc.x * frame.right.xyz + ndc.y * frame.up.xyz;
}

fn equirectangular(d: vec3f) -> vec2f {
    return vec2f(atan2(d.x, -d.z) / (2.0 * PI) + 0.5, acos(clamp(d.y, -1.0, 1.0)) / PI);
}

// The ambient sky blurred as a surface of this roughness sees it.
fn glossy(direction: vec3f, roughness: f32) -> vec3f {
    let uv = equirectangular(direction);
    let level = clamp(roughness, 0.0, 1.0) * f32(ROUGH) - 1.0;
    let low = i32(max(floor(level), 0.0));
    let blurred = textureSampleLevel(environment, sky_sampler, uv, low, 0.0).rgb;
    if (level >= 0.0) {
        let more = textureSampleLevel(environment, sky_sampler, uv, min(low + 1, ROUGH - 1), 0.0).rgb;
        return mix(blurred, more, level - f32(low));
    }
    return mix(textureSampleLevel(ambient, sky_sampler, uv, 0.0).rgb, blurred, level + 1.0);
}

// What is seen where nothing was hit, suns included.
fn background(direction: vec3f) -> vec3f {
    var color = textureSampleLevel(sky, sky_sampler, equirectangular(direction), 0.0).rgb;
    for (var k = 0u; k < frame.light_count && frame.sun_disc != 0u; k++) {
        let sun = lights[k];
        if (sun.kind == 0u) {
            let away = length(direction + sun.direction);  // the angle, for small angles
            let disc = 1.0 - smoothstep(0.8, 1.2, away / max(sun.radius, 1e-3));
            let bright = min(1.0 / (PI * sun.radius * sun.radius + 1e-6), 500.0);
            color += sun.color * (disc * bright + 0.12 * exp(-away * 14.0) + 0.02 * exp(-away * 3.0));
        }
    }
    return color;
}

// Split-sum table: the reflected part of a uniform sky is f0 * x + y.
fn directional_albedo(facing: f32, roughness: f32) -> vec2f {
    let uv = vec2f(facing * 63.0 + 0.5, roughness * 31.0 + 0.5) / vec2f(64.0, 32.0);
    return textureSampleLevel(environment, sky_sampler, uv, ROUGH + 1, 0.0).rg;
}

// GGX, height-correlated Smith, Schlick's Fresnel: the specular brdf times cos(light). `alpha` may be widened by the
// light's size; `norm` keeps the energy of the unwidened lobe.
fn specular(n: vec3f, v: vec3f, l: vec3f, f0: vec3f, alpha: f32, widened: f32) -> vec3f {
    let h = normalize(v + l);
    let nl = max(dot(n, l), 0.0);
    let nv = max(dot(n, v), 1e-3);
    let nh = max(dot(n, h), 0.0);
    let a2 = widened * widened;
    let d = nh * nh * (a2 - 1.0) + 1.0;
    let distribution = a2 / (PI * d * d);
    let s2 = alpha * alpha;
    let smith = 0.5 / (nl * sqrt(nv * nv * (1.0 - s2) + s2) + nv * sqrt(nl * nl * (1.0 - s2) + s2) + 1e-5);
    let f = f0 + (1.0 - f0) * pow(1.0 - max(dot(v, h), 0.0), 5.0);
    return f * distribution * smith * nl;
}
