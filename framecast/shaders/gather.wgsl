// Adds one jittered picture to the reference. Colours are averaged as c / (1 + max c), which is undone at the end: a mean
// of plain radiance would leave jagged edges wherever something very bright meets something dark.

struct Sample {
    size: vec2u,
    index: u32,     // of this picture among the samples of a pixel; 0 starts anew
    exposure: f32,  // unused
};

@group(0) @binding(0) var<uniform> sample: Sample;
@group(0) @binding(1) var<storage, read_write> sums: array<vec4f>;
@group(0) @binding(2) var lit: texture_2d<f32>;

@compute @workgroup_size(16, 8)
fn main(@builtin(global_invocation_id) id: vec3u) {
    if (any(id.xy >= sample.size)) {
        return;
    }
    let at = id.y * sample.size.x + id.x;
    let color = textureLoad(lit, id.xy, 0).rgb;
    let coded = vec4f(color / (1.0 + max(color.r, max(color.g, color.b))), 1.0);
    if (sample.index == 0u) {
        sums[at] = coded;
    } else {
        sums[at] += coded;
    }
}
