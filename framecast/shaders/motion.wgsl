// The second pass, only where vectors are written: where each visible surface point was two frames and one frame ago, and
// where it will be one frame on. Drawn over the depth of the first pass with "equal", so it sees the same samples.

struct Motion {
    previous: mat4x4f,    // to clip space at time - 1, unjittered
    earlier: mat4x4f,     // time - 2
    next: mat4x4f,        // time + 1
    model: mat4x4f,       // to the world at time - 1
};

@group(0) @binding(2) var<storage, read> motions: array<Motion>;
@group(0) @binding(3) var<uniform> screen: vec4f;  // width, height in pixels; near distance

struct Corner {
    @invariant @builtin(position) position: vec4f,
    @location(0) now: vec3f,        // clip x, y, w, all unjittered
    @location(1) previous: vec3f,
    @location(2) earlier: vec3f,
    @location(3) next: vec3f,
    @location(4) normal: vec3f,
};

@vertex
fn vertex(
    @location(0) position: vec3f,
    @location(1) previous: vec3f,
    @location(2) earlier: vec3f,
    @location(3) next: vec3f,
    @location(4) normal: vec3f,
    @builtin(instance_index) index: u32,
) -> Corner {
    let motion = motions[index];
    let clip = instances[index].clip * vec4f(position, 1.0);
    var out: Corner;
    out.position = vec4f(clip.xy + view.jitter * clip.w, clip.zw);
    out.now = clip.xyw;
    out.previous = (motion.previous * vec4f(previous, 1.0)).xyw;
    out.earlier = (motion.earlier * vec4f(earlier, 1.0)).xyw;
    out.next = (motion.next * vec4f(next, 1.0)).xyw;
    out.normal = turn_normal(motion.model, normal);
    return out;
}

struct Vectors {
    @location(0) motion: vec2f,
    @location(1) motion2: vec2f,
    @location(2) motion_next: vec2f,
    @location(3) depth: f32,        // of the same point at time - 1, along that camera's axis
    @location(4) normal: vec2f,     // vertex normal at time - 1, folded
};

// Pixels from one clip position (x, y, w) to another, y down. Points behind a camera count as far off screen.
fn pixels(from_: vec3f, to: vec3f) -> vec2f {
    let there = to.xy / max(to.z, screen.z);
    let step = (there - from_.xy / from_.z) * 0.5 * screen.xy * vec2f(1.0, -1.0);
    return clamp(step, vec2f(-3e4), vec2f(3e4));
}

@fragment
fn fragment(in: Corner, @builtin(front_facing) front: bool) -> Vectors {
    var out: Vectors;
    out.motion = pixels(in.now, in.previous);
    out.motion2 = pixels(in.now, in.earlier);
    out.motion_next = pixels(in.now, in.next);
    out.depth = in.previous.z;
    out.normal = fold(normalize(in.normal) * select(-1.0, 1.0, front));
    return out;
}
