// Soft shadows: how far the blockers stand off gives the width of the penumbra (percentage-closer soft shadows).

const SEARCH = 8u;
const TAPS = 16u;

// Lit part of a sun with `map` as its cascade. `penumbra` is the sun's angular radius.
fn sun_map(map: ShadowMap, position: vec3f, penumbra: f32, start: vec2f) -> f32 {
    let clip = map.matrix * vec4f(position, 1.0);
    let uv = clip.xy * vec2f(0.5, -0.5) + 0.5;
    let size = f32(textureDimensions(sun_depths).x);
    let per_unit = 1.0 / (map.texel * size);  // uv per scene unit
    let narrow = 1.2 / size;
    let reach = clamp(penumbra * map.range * 0.5 * per_unit, narrow, 60.0 / size);
    var blockers = 0.0;
    var height = 0.0;
    var direction = start;
    for (var k = 0u; k < SEARCH; k++) {
        let at = vec2i((uv + direction * (out_on_disc(k, SEARCH) * reach)) * size);
        let depth = textureLoad(sun_depths, at, map.layer, 0);
        let blocks = select(0.0, 1.0, depth > clip.z);
        blockers += blocks;
        height += blocks * (depth - clip.z);
        direction = next_on_disc(direction);
    }
    if (blockers == 0.0) {
        return 1.0;
    }
    let radius = clamp(height / blockers * map.range * penumbra * per_unit, narrow, reach);
    if (blockers == f32(SEARCH) && radius * 3.0 < reach) {
        return 0.0;
    }
    var lit = 0.0;
    for (var k = 0u; k < TAPS; k++) {
        let at = uv + direction * (out_on_disc(k, TAPS) * radius);
        lit += textureSampleCompareLevel(sun_depths, shadow_sampler, at, map.layer, clip.z);
        direction = next_on_disc(direction);
    }
    return lit / f32(TAPS);
}

fn sun_shadow(light: Light, s: Surface, start: vec2f) -> f32 {
    let cascade = select(0u, 1u, s.depth > light.splits.x) + select(0u, 1u, s.depth > light.splits.y);
    if (s.depth > light.splits.z) {
        return 1.0;
    }
    let map = shadow_maps[light.shadow + cascade];
    let slope = 1.0 - abs(dot(s.geometric, light.direction));
    let position = s.position + s.geometric * map.texel * (1.0 + 2.0 * slope) - light.direction * map.texel;
    return mix(sun_map(map, position, light.radius, start), 1.0, smoothstep(0.9, 1.0, s.depth / light.splits.z));
}

// Which of a lamp's maps looks along `d` (from the lamp): the faces +x -x +y -y +z -z of a cube, or the only one.
fn face(light: Light, d: vec3f) -> u32 {
    if (light.shadows == 1u) {
        return light.shadow;
    }
    let a = abs(d);
    if (a.x >= a.y && a.x >= a.z) {
        return light.shadow + select(0u, 1u, d.x < 0.0);
    }
    if (a.y >= a.z) {
        return light.shadow + select(2u, 3u, d.y < 0.0);
    }
    return light.shadow + select(4u, 5u, d.z < 0.0);
}

// Lit part of a point or spot light. Taps lie on a disc that faces the lamp; the maps of a point light overlap, so that all
// taps can be looked up in the map of the disc's centre.
fn lamp_shadow(light: Light, s: Surface, start: vec2f) -> f32 {
    let away = s.position - light.position;
    let distance = length(away);
    let texel = shadow_maps[light.shadow].texel * distance;
    let slope = 1.0 - abs(dot(s.geometric, away / distance));
    let position = s.position + s.geometric * texel * (1.0 + 2.0 * slope) - away / distance * texel;
    let axis = normalize(position - light.position);
    let helper = select(vec3f(1.0, 0.0, 0.0), vec3f(0.0, 1.0, 0.0), abs(axis.x) > 0.7);
    let u = normalize(cross(axis, helper));
    let map = shadow_maps[face(light, position - light.position)];
    let centre = map.matrix * vec4f(position, 1.0);
    let along_u = map.matrix * vec4f(u, 0.0);
    let along_v = map.matrix * vec4f(cross(axis, u), 0.0);
    if (centre.w <= map.range || any(abs(centre.xy) > vec2f(centre.w))) {
        return 1.0;
    }
    let size = f32(textureDimensions(lamp_depths).x);
    let reach = max(min(light.radius, 0.12 * distance), 1.2 * texel);
    var blockers = 0.0;
    var ratios = 0.0;
    var direction = start;
    for (var k = 0u; k < SEARCH; k++) {
        let o = direction * (out_on_disc(k, SEARCH) * reach);
        let clip = centre + along_u * o.x + along_v * o.y;
        let at = vec2i((clip.xy / clip.w * vec2f(0.5, -0.5) + 0.5) * size);
        let depth = textureLoad(lamp_depths, at, map.layer, 0);
        let ours = map.range / clip.w;
        let blocks = select(0.0, 1.0, depth > ours);
        blockers += blocks;
        ratios += blocks * ours / max(depth, 1e-9);  // the blocker's distance over ours
        direction = next_on_disc(direction);
    }
    if (blockers == 0.0) {
        return 1.0;
    }
    let ratio = clamp(ratios / blockers, 0.05, 1.0);
    let radius = clamp(light.radius * (1.0 - ratio) / ratio, 1.2 * texel, reach);
    if (blockers == f32(SEARCH) && radius * 3.0 < reach) {
        return 0.0;
    }
    var lit = 0.0;
    for (var k = 0u; k < TAPS; k++) {
        let o = direction * (out_on_disc(k, TAPS) * radius);
        let clip = centre + along_u * o.x + along_v * o.y;
        let uv = clip.xy / clip.w * vec2f(0.5, -0.5) + 0.5;
        lit += textureSampleCompareLevel(lamp_depths, shadow_sampler, uv, map.layer, map.range / clip.w);
        direction = next_on_disc(direction);
    }
    return lit / f32(TAPS);
}
