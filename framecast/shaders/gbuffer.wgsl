// The first pass: what is seen at each sample, in 32 bytes.

struct Corner {
    @invariant @builtin(position) position: vec4f,
    @location(0) world: vec3f,
    @location(1) normal: vec3f,
    @location(2) tangent: vec4f,
    @location(3) uv: vec2f,
    @location(4) @interpolate(flat) index: u32,
};

@vertex
fn vertex(
    @location(0) position: vec3f,
    @location(1) normal: vec3f,
    @location(2) tangent: vec4f,
    @location(3) uv: vec2f,
    @builtin(instance_index) index: u32,
) -> Corner {
    let instance = instances[index];
    var out: Corner;
    let clip = instance.clip * vec4f(position, 1.0);
    out.position = vec4f(clip.xy + view.jitter * clip.w, clip.zw);
    out.world = (instance.model * vec4f(position, 1.0)).xyz;
    out.normal = turn_normal(instance.model, normal);
    out.tangent = vec4f((instance.model * vec4f(tangent.xyz, 0.0)).xyz, tangent.w);
    out.uv = uv;
    out.index = index;
    return out;
}

struct Sample {
    @location(0) albedo: vec4f,     // rgb, roughness
    @location(1) normal: vec4f,     // normal-mapped world normal, metallic
    @location(2) emissive: vec4f,   // rgb, unused
    @location(3) geometric: vec2f,  // interpolated vertex normal, folded
    @location(4) object: u32,       // id | (mirror << 16)
};

@fragment
fn fragment(in: Corner, @builtin(front_facing) front: bool) -> Sample {
    let base = textureSampleBias(base_map, base_sampler, in.uv, view.lod_bias) * material.base;
    let mapped = textureSampleBias(normal_map, normal_sampler, in.uv, view.lod_bias).xyz * 2.0 - 1.0;
    let surface = textureSampleBias(surface_map, surface_sampler, in.uv, view.lod_bias);
    let glow = textureSampleBias(emissive_map, emissive_sampler, in.uv, view.lod_bias).rgb;
    if (MASK && base.a < material.cutoff) {
        discard;
    }
    if (CLIP && dot(view.plane, vec4f(in.world, 1.0)) < 0.0) {
        discard;
    }
    let side = select(-1.0, 1.0, front);
    let n = normalize(in.normal) * side;
    let t = normalize(in.tangent.xyz - n * dot(n, in.tangent.xyz));
    let b = cross(n, t) * in.tangent.w * side;
    let local = vec3f(mapped.xy * material.normal_scale, mapped.z);
    let bent = normalize(t * local.x + b * local.y + n * max(local.z, 0.05));
    let instance = instances[in.index];
    var out: Sample;
    out.albedo = vec4f(base.rgb, clamp(surface.g * material.roughness, 0.0, 1.0));
    out.normal = vec4f(bent, clamp(surface.b * material.metallic, 0.0, 1.0));
    out.emissive = vec4f(min(glow * material.emissive, vec3f(6e4)), 0.0);
    out.geometric = fold(n);
    out.object = instance.object | (instance.mirror << 16u);
    return out;
}
