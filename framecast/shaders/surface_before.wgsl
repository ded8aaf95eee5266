// The surface that a pixel shows now, as it was one frame ago: for telling moving shading from moving surfaces. Lit with
// the lights, the shadows and the camera of that time, it gives the colour that the same point had then.

@group(0) @binding(0) var albedo_map: texture_2d<f32>;
@group(0) @binding(1) var normal_map: texture_2d<f32>;
@group(0) @binding(2) var emissive_map: texture_2d<f32>;
@group(0) @binding(3) var geometric_map: texture_2d<f32>;
@group(0) @binding(4) var object_map: texture_2d<u32>;
@group(0) @binding(5) var motion_map: texture_2d<f32>;
@group(0) @binding(6) var occlusion_map: texture_2d<f32>;
@group(0) @binding(7) var depth_before: texture_2d<f32>;
@group(0) @binding(8) var normal_before: texture_2d<f32>;

// `v` turned as the shortest turn takes `a` to `b`.
fn turn(v: vec3f, a: vec3f, b: vec3f) -> vec3f {
    let axis = cross(a, b);
    let c = dot(a, b);
    return v * c + cross(axis, v) + axis * dot(axis, v) / max(1.0 + c, 1e-4);
}

fn surface(at: vec2i) -> Surface {
    var s: Surface;
    s.depth = textureLoad(depth_before, at, 0).r;
    s.pixel = vec2f(at) + 0.5 + textureLoad(motion_map, at, 0).xy;
    let ray = ray_through(s.pixel + frame.jitter);
    if (s.depth >= SKY) {
        s.position = ray;
        return s;
    }
    s.position = frame.eye.xyz + s.depth * ray;
    let albedo = textureLoad(albedo_map, at, 0);
    let normal = textureLoad(normal_map, at, 0);
    s.albedo = albedo.rgb;
    s.roughness = albedo.a;
    s.metallic = normal.a;
    s.emissive = textureLoad(emissive_map, at, 0).rgb;
    s.geometric = unfold(textureLoad(normal_before, at, 0).xy);
    s.normal = turn(normalize(normal.xyz), unfold(textureLoad(geometric_map, at, 0).xy), s.geometric);
    s.occlusion = textureLoad(occlusion_map, at, 0).r;
    s.mirror = textureLoad(object_map, at, 0).r >> 16u;
    return s;
}
