// A height array by its cubic B-spline: see scene/surface.py for the formulas.
// Coefficients come as float pairs, high and low part, and are summed relative to the nearest node: slopes are
// differences of neighbours, and float32 heights of 1 mm at 0.1 mm pitch would make them wrong by 1e-6 rad.
uniform sampler2D coefficients;  // (columns + 2, rows + 2)
uniform vec2 grid_origin;        // mm
uniform vec2 grid_step;          // mm

vec4 spline(float t) {
    float s = 1.0 - t;
    return vec4(s * s * s, 4.0 + t * t * (3.0 * t - 6.0), 4.0 + s * s * (3.0 * s - 6.0), t * t * t) / 6.0;
}

vec4 spline_slope(float t) {
    float s = 1.0 - t;
    return vec4(-0.5 * s * s, t * (1.5 * t - 2.0), -s * (1.5 * s - 2.0), 0.5 * t * t);
}

vec3 surface(vec2 at) {
    ivec2 nodes = textureSize(coefficients, 0) - 2;
    vec2 free = (at - grid_origin) / grid_step;
    vec2 held = clamp(free, vec2(0.0), vec2(nodes - 1));
    ivec2 cell = min(ivec2(held), nodes - 2);
    vec2 t = held - vec2(cell);
    vec4 wx = spline(t.x), sx = spline_slope(t.x), wy = spline(t.y), sy = spline_slope(t.y);
    vec2 base = texelFetch(coefficients, cell + 1, 0).rg;
    vec3 sum = vec3(0.0);
    for (int i = 0; i < 4; ++i) {
        vec4 line;
        for (int j = 0; j < 4; ++j) {
            vec2 c = texelFetch(coefficients, cell + ivec2(j, i), 0).rg;
            line[j] = (c.x - base.x) + (c.y - base.y);
        }
        float a = dot(wx, line);
        sum += vec3(wy[i] * a, wy[i] * dot(sx, line), sy[i] * a);
    }
    return vec3(base.x + sum.x, sum.yz / grid_step * vec2(equal(free, held)));
}
