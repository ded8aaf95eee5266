// Radiance of a surface towards the camera, times exposure.

struct Radiance {
    diffuse: vec3f,
    gloss: vec3f,
};

fn planar_reflection(s: Surface, alpha: f32, start: vec2f) -> vec3f {
    let layer = s.mirror - 1u;
    let bend = s.normal - s.geometric;
    let right = frame.right.xyz / length(frame.right.xyz);
    let up = frame.up.xyz / length(frame.up.xyz);
    let straight = textureSampleLevel(reflections, linear_sampler, s.pixel / frame.size, layer, 0.0);
    let behind = 1.0 - s.depth / max(straight.a, s.depth);
    let shift = vec2f(dot(bend, right), -dot(bend, up)) * 2.0 * behind * frame.focal;
    let radius = alpha * 1.2 * behind * frame.focal;
    if (radius < 0.5 && dot(shift, shift) < 0.01) {
        return straight.rgb;
    }
    var sum = vec3f(0.0);
    var total = 0.0;
    var direction = start;
    for (var k = 0u; k < 24u; k++) {
        let o = direction * out_on_disc(k, 24u);
        direction = next_on_disc(direction);
        let at = (s.pixel + shift + o * radius) / frame.size;
        let hit = textureSampleLevel(reflections, linear_sampler, clamp(at, vec2f(0.0), vec2f(1.0)), layer, 0.0);
        let weight = exp(-2.0 * dot(o, o)) * step(s.depth * 0.98, hit.a);
        sum += weight * hit.rgb / (1.0 + max(hit.r, max(hit.g, hit.b)));  // keeps single bright texels from showing as discs
        total += weight;
    }
    let mean = sum / max(total, 1e-4);
    return mean / max(1.0 - max(mean.r, max(mean.g, mean.b)), 1e-3);
}

fn surroundings(s: Surface, v: vec3f, f0: vec3f, energy: vec2f, start: vec2f) -> Radiance {
    let facing = clamp(dot(s.normal, v), 0.0, 1.0);
    let bounced = f0 * energy.x + energy.y;
    let gain = 1.0 + f0 * (1.0 / (energy.x + energy.y) - 1.0);  // light that bounces between the microfacets
    let reflected = reflect(-v, s.normal);
    let alpha = s.roughness * s.roughness;
    var mirror = glossy(reflected, s.roughness) * frame.exposure;
    let horizon = clamp(1.0 + dot(reflected, s.geometric), 0.0, 1.0);
    var open = clamp(pow(facing + s.occlusion, exp2(-16.0 * s.roughness - 1.0)) - 1.0 + s.occlusion, 0.0, 1.0);
    open *= horizon * horizon;
    if (s.mirror != 0u && s.mirror <= frame.mirrors) {
        mirror = planar_reflection(s, alpha, start);
        open = 1.0;
    }
    let irradiance = textureSampleLevel(environment, sky_sampler, equirectangular(s.normal), ROUGH, 0.0).rgb;
    let diffuse = s.albedo * (1.0 - s.metallic) * (1.0 - bounced) * irradiance * frame.exposure;
    // light that bounces off the occluders, which are taken to be as bright as the surface itself
    let soft = s.occlusion / (1.0 - s.albedo * (1.0 - s.occlusion) * 0.8);
    return Radiance(diffuse * soft, mirror * bounced * gain * open);
}

fn falloff(light: Light, distance: f32, toward: vec3f) -> f32 {
    let window = clamp(1.0 - pow(distance / light.reach, 4.0), 0.0, 1.0);
    var strength = window * window / max(distance * distance, max(light.radius * light.radius, 1e-4));
    if (light.kind == 2u) {
        strength *= smoothstep(light.outer, light.inner, -dot(toward, light.direction));
    }
    return strength;
}

fn direct(light: Light, s: Surface, v: vec3f, f0: vec3f, energy: vec2f, start: vec2f) -> Radiance {
    var toward = -light.direction;
    var strength = 1.0;
    var size = light.radius;
    if (light.kind != 0u) {
        let offset = light.position - s.position;
        let distance = max(length(offset), 1e-4);
        toward = offset / distance;
        strength = falloff(light, distance, toward);
        size = light.radius / distance;
    }
    let facing = dot(s.normal, toward);
    let above = smoothstep(-0.05, 0.05, dot(s.geometric, toward));
    if (facing <= 0.0 || strength * above <= 0.0) {
        return Radiance(vec3f(0.0), vec3f(0.0));
    }
    var lit = 1.0;
    if (light.shadows != 0u) {
        if (light.kind == 0u) {
            lit = sun_shadow(light, s, start);
        } else {
            lit = lamp_shadow(light, s, start);
        }
    }
    if (lit <= 0.0) {
        return Radiance(vec3f(0.0), vec3f(0.0));
    }
    let alpha = max(s.roughness * s.roughness, 0.004);
    let widened = min(alpha + 0.5 * size, 1.0);
    let gain = 1.0 + f0 * (1.0 / (energy.x + energy.y) - 1.0);
    let diffuse = s.albedo * (1.0 - s.metallic) * (1.0 - (f0 * energy.x + energy.y)) / PI * facing;
    let arriving = light.color * (strength * above * lit);
    return Radiance(arriving * diffuse, arriving * specular(s.normal, v, toward, f0, alpha, widened) * gain);
}

fn hazy(color: vec3f, direction: vec3f, distance: f32) -> vec3f {
    let air = glossy(normalize(vec3f(direction.x, max(direction.y, 0.0) + 0.05, direction.z)), 0.6) * frame.exposure;
    return mix(air, color, exp(-frame.haze * distance));
}

fn radiance(s: Surface) -> Radiance {
    let v = -normalize(s.position - frame.eye.xyz);
    let f0 = mix(vec3f(0.04), s.albedo, s.metallic);
    let start = first_on_disc(pattern_angle());
    let energy = directional_albedo(clamp(dot(s.normal, v), 0.0, 1.0), s.roughness);
    var sum = surroundings(s, v, f0, energy, start);
    for (var k = 0u; k < frame.light_count; k++) {
        let more = direct(lights[k], s, v, f0, energy, start);
        sum.diffuse += more.diffuse * frame.exposure;
        sum.gloss += more.gloss * frame.exposure;
    }
    sum.diffuse += s.emissive * frame.exposure;
    return sum;
}

fn through_air(s: Surface, color: vec3f) -> vec3f {
    let ray = s.position - frame.eye.xyz;
    if (frame.haze > 0.0) {
        return hazy(min(color, vec3f(6e4)), normalize(ray), length(ray));
    }
    return min(color, vec3f(6e4));
}
