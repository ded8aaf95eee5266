// How much of the sky a surface sees, from the depths around it. The same taps everywhere: nothing here is random.

@group(0) @binding(0) var depth_map: texture_depth_2d;
@group(0) @binding(1) var geometric_map: texture_2d<f32>;

const AROUND = 16u;

@vertex
fn vertex(@builtin(vertex_index) index: u32) -> @builtin(position) vec4f {
    return vec4f(f32(index & 1u) * 4.0 - 1.0, f32(index >> 1u) * 4.0 - 1.0, 0.0, 1.0);
}

// Relative to the eye, in world axes.
fn place(at: vec2i) -> vec3f {
    let depth = frame.near / max(textureLoad(depth_map, at, 0), 1e-7);
    return depth * ray_through(vec2f(at) + 0.5 + frame.jitter);
}

@fragment
fn fragment(@builtin(position) centre: vec4f) -> @location(0) vec4f {
    let at = vec2i(centre.xy);
    let stored = textureLoad(depth_map, at, 0);
    if (stored <= 0.0) {
        return vec4f(1.0);
    }
    let p = place(at);
    let n = unfold(textureLoad(geometric_map, at, 0).xy);
    let depth = frame.near / stored;
    let radius = frame.ambient_occlusion;
    let reach = clamp(radius * frame.focal / depth, 3.0, 0.2 * frame.size.y);
    let limit = vec2i(frame.size) - 1;
    var sum = 0.0;
    var direction = first_on_disc(pattern_angle());
    for (var k = 0u; k < AROUND; k++) {
        let tap = vec2i(floor(centre.xy + direction * out_on_disc(k, AROUND) * reach));
        direction = next_on_disc(direction);
        if (any(tap < vec2i(0)) || any(tap > limit)) {
            continue;
        }
        let d = place(tap) - p;
        let d2 = dot(d, d);
        let fall = max(1.0 - d2 / (radius * radius), 0.0);
        sum += fall * max(dot(d, n) - 0.004 * depth, 0.0) * inverseSqrt(d2 + 1e-6);
    }
    let open = clamp(1.0 - 1.8 * sum / f32(AROUND), 0.0, 1.0);
    return vec4f(open, 0.0, 0.0, 0.0);
}
