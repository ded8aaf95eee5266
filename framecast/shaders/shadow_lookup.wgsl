// Soft shadows: how far the blockers stand off gives the width of the penumbra (percentage-closer soft shadows).

const SEARCH = 12u;
const TAPS = 20u;

// Lit part of a sun with `map` as its cascade. `penumbra` is the sun's angular radius.
fn sun_map(map: ShadowMap, position: vec3f, penumbra: f32, angle: f32) -> f32 {
    let clip = map.matrix * vec4f(position, 1.0);
    let uv = clip.xy * vec2f(0.5, -0.5) + 0.5;
    let size = f32(textureDimensions(sun_depths).x);
    let per_unit = 1.0 / (map.texel * size);  // uv per scene unit
    let reach = min(penumbra * map.range * 0.5, 60.0 * map.texel) * per_unit;
    var blockers = 0.0;
    var height = 0.0;
    for (var k = 0u; k < SEARCH; k++) {
        let at = vec2i((uv + disc(k, SEARCH, angle) * max(reach, 1.5 / size)) * size);
        let depth = textureLoad(sun_depths, clamp(at, vec2i(0), vec2i(i32(size) - 1)), map.layer, 0);
        if (depth > clip.z) {
            blockers += 1.0;
            height += (depth - clip.z) * map.range;
        }
    }
    if (blockers == 0.0) {
        return 1.0;
    }
    let radius = clamp(height / blockers * penumbra * per_unit, 1.0 / size, max(reach, 1.5 / size));
    var lit = 0.0;
    for (var k = 0u; k < TAPS; k++) {
        let at = uv + disc(k, TAPS, angle) * radius;
        lit += textureSampleCompareLevel(sun_depths, shadow_sampler, at, map.layer, clip.z);
    }
    return lit / f32(TAPS);
}

fn sun_shadow(light: Light, s: Surface, angle: f32) -> f32 {
    let slope = 1.0 - abs(dot(s.geometric, light.direction));
    for (var k = 0u; k < light.shadows; k++) {
        let map = shadow_maps[light.shadow + k];
        if (s.depth < map.far) {
            let position = s.position + s.geometric * map.texel * (1.0 + 2.0 * slope) - light.direction * map.texel;
            let lit = sun_map(map, position, light.radius, angle);
            let fade = smoothstep(0.9, 1.0, s.depth / map.far);
            return select(lit, mix(lit, 1.0, fade), k + 1u == light.shadows);
        }
    }
    return 1.0;
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

// uv in the map, and the reversed depth; depth 2 (lit) outside of it.
fn lamp_place(map: ShadowMap, position: vec3f) -> vec3f {
    let clip = map.matrix * vec4f(position, 1.0);
    let uv = clip.xy / clip.w * vec2f(0.5, -0.5) + 0.5;
    let inside = clip.w > 0.0 && all(uv >= vec2f(0.0)) && all(uv <= vec2f(1.0));
    return vec3f(uv, select(2.0, clip.z / clip.w, inside));
}

fn lamp_shadow(light: Light, s: Surface, angle: f32) -> f32 {
    let away = s.position - light.position;
    let distance = length(away);
    let texel = shadow_maps[light.shadow].texel * distance;
    let slope = 1.0 - abs(dot(s.geometric, away / distance));
    let position = s.position + s.geometric * texel * (1.0 + 2.0 * slope) - away / distance * texel;
    let axis = normalize(position - light.position);
    let helper = select(vec3f(1.0, 0.0, 0.0), vec3f(0.0, 1.0, 0.0), abs(axis.x) > 0.7);
    let u = normalize(cross(axis, helper));
    let v = cross(axis, u);
    let size = f32(textureDimensions(lamp_depths).x);
    let reach = max(min(light.radius, 0.15 * distance), 1.5 * texel);
    var blockers = 0.0;
    var depth_sum = 0.0;
    for (var k = 0u; k < SEARCH; k++) {
        let o = disc(k, SEARCH, angle) * reach;
        let p = position + u * o.x + v * o.y;
        let map = shadow_maps[face(light, p - light.position)];
        let place = lamp_place(map, p);
        let at = clamp(vec2i(place.xy * size), vec2i(0), vec2i(i32(size) - 1));
        let depth = textureLoad(lamp_depths, at, map.layer, 0);
        if (depth > place.z) {
            blockers += 1.0;
            depth_sum += map.range / depth / (map.range / place.z);  // blocker's distance over ours
        }
    }
    if (blockers == 0.0) {
        return 1.0;
    }
    let ratio = clamp(depth_sum / blockers, 0.05, 1.0);
    let radius = clamp(light.radius * (1.0 - ratio) / ratio, texel, reach);
    var lit = 0.0;
    for (var k = 0u; k < TAPS; k++) {
        let o = disc(k, TAPS, angle) * radius;
        let p = position + u * o.x + v * o.y;
        let map = shadow_maps[face(light, p - light.position)];
        let place = lamp_place(map, p);
        lit += textureSampleCompareLevel(lamp_depths, shadow_sampler, place.xy, map.layer, place.z);
    }
    return lit / f32(TAPS);
}
