// The closed forms of scene/dent_forms.py, one per program; uniforms are named as the parameters there.

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

// arcsin(1 / q) for q >= 1 to float32's relative precision (the built-in asin is good to 4e-4 only); the minimax
// polynomial holds for arguments up to 1/2, beyond it arcsin(v) = pi/2 - 2 arcsin(sqrt((1 - v) / 2)).
float arc_cosecant(float q2) {
    bool beyond = q2 < 4.0;
    float w = beyond ? 0.5 * (q2 - 1.0) / (q2 + sqrt(q2)) : 1.0 / q2;
    float p = 0.033409433;
    p = p * w + 0.017347945;
    p = p * w + 0.031049470;
    p = p * w + 0.044605188;
    p = p * w + 0.075000679;
    p = p * w + 0.166666667;
    float arc = sqrt(w) * (1.0 + w * p);
    return beyond ? 1.57079632679 - 2.0 * arc : arc;
}

// x - sin x for 0 <= x <= pi without cancelling digits: minimax, relative error 2e-9.
float less_sine(float x) {
    float w = x * x, p = -1.3904082e-10;
    p = p * w + 2.4812717e-8;
    p = p * w - 2.7544842e-6;
    p = p * w + 1.9840972e-4;
    p = p * w - 8.3333307e-3;
    p = p * w + 0.16666667;
    return x * w * p;
}

// Off the contact, with x = 2 arcsin(1 / q): slope = (sin x - x) q / pi, height = x / pi + slope q / 2.
vec3 surface(vec2 at) {
    vec2 d = (at - vec2(x, y)) / contact;
    float q2 = dot(d, d);
    float height = 1.0 - 0.5 * q2, over_q = -1.0;
    if (q2 > 1.0) {
        float arc = 2.0 * arc_cosecant(q2);
        over_q = -less_sine(arc) / 3.14159265359;
        height = arc / 3.14159265359 + 0.5 * q2 * over_q;
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
