// Surfaces with opacity: lit while drawn, back to front, over the lit picture. They leave no trace in the other buffers.

struct Corner {
    @builtin(position) position: vec4f,
    @location(0) world: vec3f,
    @location(1) normal: vec3f,
    @location(2) tangent: vec4f,
    @location(3) uv: vec2f,
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
    let clip = instance.clip * vec4f(position, 1.0);
    var out: Corner;
    out.position = vec4f(clip.xy + view.jitter * clip.w, clip.zw);
    out.world = (instance.model * vec4f(position, 1.0)).xyz;
    out.normal = turn_normal(instance.model, normal);
    out.tangent = vec4f((instance.model * vec4f(tangent.xyz, 0.0)).xyz, tangent.w);
    out.uv = uv;
    return out;
}

@fragment
fn fragment(in: Corner, @builtin(front_facing) front: bool) -> @location(0) vec4f {
    let t = texels(in.uv);
    let side = select(-1.0, 1.0, front);
    let n = normalize(in.normal) * side;
    var s: Surface;
    s.position = in.world;
    s.depth = 1.0 / in.position.w;
    s.pixel = in.position.xy;
    s.normal = bent(n, in.tangent, t.normal, side);
    s.geometric = n;
    s.albedo = t.base.rgb;
    s.roughness = t.roughness;
    s.metallic = t.metallic;
    s.emissive = t.emissive;
    s.occlusion = 1.0;
    let seen = radiance(s);
    // what it reflects comes on top of what shines through
    return vec4f(through_air(s, seen.diffuse + seen.gloss / max(t.base.a, 0.05)), t.base.a);
}
