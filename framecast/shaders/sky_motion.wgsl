// Motion of what is infinitely far away: drawn where the depth is still clear. Only rotations move the sky.

struct Turn {
    screen: vec4f,          // width, height; the sample's offset from the pixel centre
    now: mat4x4f,           // clip x, y (at w = 1) to a world direction, unjittered
    current: mat4x4f,       // and back: the same arithmetic on both ends makes a still sky exactly still
    previous: mat4x4f,      // world direction to clip x, y, w of time - 1
    earlier: mat4x4f,
    next: mat4x4f,
};

@group(0) @binding(0) var<uniform> turn: Turn;

@vertex
fn vertex(@builtin(vertex_index) index: u32) -> @invariant @builtin(position) vec4f {
    return vec4f(f32(index & 1u) * 4.0 - 1.0, f32(index >> 1u) * 4.0 - 1.0, 0.0, 1.0);
}

fn place(to: mat4x4f, direction: vec3f) -> vec2f {
    let clip = to * vec4f(direction, 0.0);
    return clip.xy / max(clip.w, 1e-4) * vec2f(0.5, -0.5) * turn.screen.xy;
}

fn pixels(to: mat4x4f, direction: vec3f) -> vec2f {
    return clamp(place(to, direction) - place(turn.current, direction), vec2f(-3e4), vec2f(3e4));
}

struct Vectors {
    @location(0) motion: vec2f,
    @location(1) motion2: vec2f,
    @location(2) motion_next: vec2f,
    @location(3) depth: f32,
    @location(4) normal: vec2f,
};

@fragment
fn fragment(@builtin(position) at: vec4f) -> Vectors {
    let position = at.xy + turn.screen.zw;
    let ndc = (position / turn.screen.xy * 2.0 - 1.0) * vec2f(1.0, -1.0);
    let direction = normalize((turn.now * vec4f(ndc, 1.0, 0.0)).xyz);
    var out: Vectors;
    out.motion = pixels(turn.previous, direction);
    out.motion2 = pixels(turn.earlier, direction);
    out.motion_next = pixels(turn.next, direction);
    out.depth = 65504.0;
    out.normal = vec2f(0.0);
    return out;
}
