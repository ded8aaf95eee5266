// What varies inside a pixel: smallest and largest colour and depth over its samples, and how far normals turn.

struct Sample {
    size: vec2u,
    index: u32,
    near: f32,
};

// Ten numbers a pixel: colour min, colour max, depth min, depth max, and the largest sum of absolute differences to the
// first sample's normal, of the shading and of the vertex normals. The first sample's normals follow, folded: 4 numbers.
const COUNT = 14u;

@group(0) @binding(0) var<uniform> sample: Sample;
@group(0) @binding(1) var<storage, read_write> found: array<f32>;
@group(0) @binding(2) var lit: texture_2d<f32>;
@group(0) @binding(3) var normals: texture_2d<f32>;
@group(0) @binding(4) var geometric: texture_2d<f32>;

fn fold(n: vec3f) -> vec2f {
    let p = n.xy / max(abs(n.x) + abs(n.y) + abs(n.z), 1e-9);
    let around = (1.0 - abs(p.yx)) * select(vec2f(-1.0), vec2f(1.0), p >= vec2f(0.0));
    return select(p, around, n.z < 0.0);
}

fn unfold(p: vec2f) -> vec3f {
    let z = 1.0 - abs(p.x) - abs(p.y);
    let t = max(-z, 0.0);
    return normalize(vec3f(p + select(vec2f(t), vec2f(-t), p >= vec2f(0.0)), z));
}

fn apart(a: vec2f, b: vec2f) -> f32 {
    let d = abs(unfold(a) - unfold(b));
    return d.x + d.y + d.z;
}

@compute @workgroup_size(16, 8)
fn main(@builtin(global_invocation_id) id: vec3u) {
    if (any(id.xy >= sample.size)) {
        return;
    }
    let at = (id.y * sample.size.x + id.x) * COUNT;
    let seen = textureLoad(lit, id.xy, 0);
    let bent = fold(textureLoad(normals, id.xy, 0).xyz);
    let plain = textureLoad(geometric, id.xy, 0).xy;
    if (sample.index == 0u) {
        for (var c = 0u; c < 3u; c++) {
            found[at + c] = seen[c];
            found[at + 3u + c] = seen[c];
        }
        found[at + 6u] = seen.a;
        found[at + 7u] = seen.a;
        found[at + 8u] = 0.0;
        found[at + 9u] = 0.0;
        found[at + 10u] = bent.x;
        found[at + 11u] = bent.y;
        found[at + 12u] = plain.x;
        found[at + 13u] = plain.y;
        return;
    }
    for (var c = 0u; c < 3u; c++) {
        found[at + c] = min(found[at + c], seen[c]);
        found[at + 3u + c] = max(found[at + 3u + c], seen[c]);
    }
    found[at + 6u] = min(found[at + 6u], seen.a);
    found[at + 7u] = max(found[at + 7u], seen.a);
    found[at + 8u] = max(found[at + 8u], apart(bent, vec2f(found[at + 10u], found[at + 11u])));
    found[at + 9u] = max(found[at + 9u], apart(plain, vec2f(found[at + 12u], found[at + 13u])));
}
