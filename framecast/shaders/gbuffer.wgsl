// The first pass: what is seen at each sample, in 32 bytes.

struct Corner {
    @invariant @builtin(position) position: vec4f,
    @location(0) world: vec3f,
    @location(1) normal: vec3f,
    @location(2) tangent: vec4f,
    @location(3) uv: vec2f,
    @location(4) @interpolate(flat) object: u32,
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
    out.object = instance.object | (instance.mirror << 16u);
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
    let t = texels(in.uv);
    if (MASK && t.base.a < material.cutoff) {
        discard;
    }
    if (CLIP && dot(view.plane, vec4f(in.world, 1.0)) < 0.0) {
        discard;
    }
    let side = select(-1.0, 1.0, front);
    let n = normalize(in.normal) * side;
    var out: Sample;
    out.albedo = vec4f(t.base.rgb, t.roughness);
    out.normal = vec4f(bent(n, in.tangent, t.normal, side), t.metallic);
    out.emissive = vec4f(t.emissive, 0.0);
    out.geometric = fold(n);
    out.object = in.object;
    return out;
}
