// Depth as a light sees it. Reversed: 1 at the light, 0 far away.

@group(2) @binding(0) var<uniform> light: mat4x4f;

struct Corner {
    @builtin(position) position: vec4f,
    @location(0) uv: vec2f,
};

@vertex
fn vertex(
    @location(0) position: vec3f,
    @location(1) normal: vec3f,
    @location(2) tangent: vec4f,
    @location(3) uv: vec2f,
    @builtin(instance_index) index: u32,
) -> Corner {
    let world = instances[index].model * vec4f(position, 1.0);
    var out: Corner;
    out.position = light * world;
    out.uv = uv;
    return out;
}

@fragment
fn fragment(in: Corner) {
    let alpha = textureSample(base_map, base_sampler, in.uv).a * material.base.a;
    if (alpha < material.cutoff) {
        discard;
    }
}
