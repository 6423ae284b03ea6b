// The closed forms of scene/forms.py, one per program; uniforms are named as the parameters there.

#ifdef TAPERED
uniform float x, y, peak, length_mm, taper;

// Height and slopes times T(x): 1 inside, smoothly 0 at x = length.
vec3 tapered(float px, vec3 shape) {
    float s = clamp((length_mm - px) / taper, 0.0, 1.0);
    float value = s * s * s * (10.0 + s * (6.0 * s - 15.0));
    float ramp = s * (1.0 - s);
    return shape * value + vec3(0.0, -30.0 / taper * ramp * ramp * shape.x, 0.0);
}
#endif

#ifdef TILT
uniform float slope, length_mm;

vec3 surface(vec2 at) {
    return vec3(slope * (length_mm - at.x), -slope, 0.0);
}
#endif

#ifdef RAISED_COSINE
uniform float peak, kx, ky;

vec3 surface(vec2 at) {
    vec2 k = vec2(kx, ky);
    vec2 s = sin(0.5 * k * at), c = cos(0.5 * k * at);
    return peak * vec3(s.x * s.x * s.y * s.y, k.x * s.x * c.x * s.y * s.y, k.y * s.y * c.y * s.x * s.x);
}
#endif

#ifdef GAUSSIAN
uniform float sigma;

vec3 surface(vec2 at) {
    vec2 d = (at - vec2(x, y)) / sigma;
    float bell = peak * exp(-0.5 * dot(d, d));
    return tapered(at.x, bell * vec3(1.0, -d / sigma));
}
#endif

#ifdef BALL
uniform float contact;

// Abramowitz & Stegun 4.4.46: 2e-8 (the built-in asin is good to 4e-4 only).
float arc_sine(float v) {
    float p = -0.0012624911;
    p = p * v + 0.0066700901;
    p = p * v - 0.0170881256;
    p = p * v + 0.0308918810;
    p = p * v - 0.0501743046;
    p = p * v + 0.0889789874;
    p = p * v - 0.2145988016;
    p = p * v + 1.5707963050;
    return 1.57079632679 - sqrt(1.0 - v) * p;
}

vec3 surface(vec2 at) {
    vec2 d = (at - vec2(x, y)) / contact;
    float q2 = dot(d, d);
    float height = 1.0 - 0.5 * q2, over_q = -1.0;
    if (q2 > 1.0) {
        float q = sqrt(q2), arc = arc_sine(1.0 / q), root = sqrt((q - 1.0) * (q + 1.0));
        height = ((2.0 - q2) * arc + root) / 3.14159265359;
        over_q = 2.0 * (root / q - q * arc) / (3.14159265359 * q);
    }
    return tapered(at.x, peak * vec3(height, over_q * d / contact));
}
#endif

#ifdef NEEDLE
uniform float decay;

vec3 surface(vec2 at) {
    vec2 d = at - vec2(x, y);
    float r = length(d), spike = peak * exp(-r / decay);
    return tapered(at.x, spike * vec3(1.0, r > 0.0 ? -d / (decay * r) : vec2(0.0)));
}
#endif

#ifdef ROUNDED_NEEDLE
uniform float decay, rounding;

vec3 surface(vec2 at) {
    vec2 d = at - vec2(x, y);
    float r2 = dot(d, d), root = sqrt(r2 + rounding * rounding);
    float spike = peak * exp(-r2 / ((root + rounding) * decay));
    return tapered(at.x, spike * vec3(1.0, -d / (decay * root)));
}
#endif

#ifdef RIDGE
uniform float sigma, nx, ny;

vec3 surface(vec2 at) {
    vec2 n = vec2(nx, ny);
    float q = dot(n, at - vec2(x, y)) / sigma;
    float bell = peak * exp(-0.5 * q * q);
    return tapered(at.x, bell * vec3(1.0, -q / sigma * n));
}
#endif
