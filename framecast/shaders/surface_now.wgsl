// The surface at a pixel, from the first pass's buffers.

@group(0) @binding(0) var albedo_map: texture_2d<f32>;
@group(0) @binding(1) var normal_map: texture_2d<f32>;
@group(0) @binding(2) var emissive_map: texture_2d<f32>;
@group(0) @binding(3) var geometric_map: texture_2d<f32>;
@group(0) @binding(4) var object_map: texture_2d<u32>;
@group(0) @binding(5) var depth_map: texture_depth_2d;
@group(0) @binding(6) var occlusion_map: texture_2d<f32>;

fn surface(at: vec2i) -> Surface {
    var s: Surface;
    s.pixel = vec2f(at) + 0.5;
    let ray = ray_through(s.pixel + frame.jitter);
    let depth = textureLoad(depth_map, at, 0);
    if (depth <= 0.0) {
        s.depth = SKY;
        s.position = ray;
        return s;
    }
    s.depth = frame.near / depth;
    s.position = frame.eye.xyz + s.depth * ray;
    let albedo = textureLoad(albedo_map, at, 0);
    let normal = textureLoad(normal_map, at, 0);
    s.albedo = albedo.rgb;
    s.roughness = albedo.a;
    s.normal = normalize(normal.xyz);
    s.metallic = normal.a;
    s.emissive = textureLoad(emissive_map, at, 0).rgb;
    s.geometric = unfold(textureLoad(geometric_map, at, 0).xy);
    s.occlusion = textureLoad(occlusion_map, at, 0).r;
    s.mirror = textureLoad(object_map, at, 0).r >> 16u;
    return s;
}
