// The lighting pass: one triangle over the picture. `surface` comes from surface_now.wgsl or surface_before.wgsl.

@vertex
fn vertex(@builtin(vertex_index) index: u32) -> @builtin(position) vec4f {
    return vec4f(f32(index & 1u) * 4.0 - 1.0, f32(index >> 1u) * 4.0 - 1.0, 0.0, 1.0);
}

@fragment
fn fragment(@builtin(position) at: vec4f) -> @location(0) vec4f {
    let s = surface(vec2i(at.xy));
    if (s.depth >= SKY) {
        return vec4f(min(background(normalize(s.position)) * frame.exposure, vec3f(6e4)), SKY);
    }
    let seen = radiance(s);
    return vec4f(through_air(s, seen.diffuse + seen.gloss), s.depth);
}
