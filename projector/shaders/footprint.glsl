// Share of a pixel's footprint left of x, per axis: see footprint.py for the formulas.

struct Footprint {
    float p, q, scale, blur;
};

#ifdef BLUR
uniform float blur;  // of the pattern, rms, in cells

// Twice integrated Gaussian, odd part; erf by Abramowitz & Stegun 7.1.26 (1.5e-7), which shares its exponential.
float twice_integrated(float t, float s) {
    float x = min(abs(t) / s * 0.70710678, 6.0);
    float w = 1.0 / (1.0 + 0.3275911 * x);
    float bell = exp(-x * x);
    float tail = w * (0.254829592 + w * (-0.284496736 + w * (1.421413741 + w * (-1.453152027 + w * 1.061405429))));
    float odd = (t * t + s * s) * 0.5 * (1.0 - tail * bell) + abs(t) * s * 0.39894228 * bell;
    return 0.5 * sign(t) * odd;
}
#else
float twice_integrated(float t, float s) {
    return 0.25 * t * abs(t);
}
#endif

Footprint footprint(vec2 boxes) {
    boxes = abs(boxes);
    float a = max(boxes.x, boxes.y), b = min(boxes.x, boxes.y), s = 0.0;
#ifdef BLUR
    float narrowest = BLUR_FLOOR * blur;
#else
    const float narrowest = SHARP_FLOOR;
#endif
    float wide = max(a, narrowest), narrow = max(b, narrowest);
#ifdef BLUR
    s = sqrt(blur * blur + (a * a - wide * wide + b * b - narrow * narrow) / 12.0);
#endif
    return Footprint(0.5 * (wide + narrow), 0.5 * (wide - narrow), 1.0 / (wide * narrow), s);
}

float reach(Footprint f) {
#ifdef BLUR
    return f.p + REACH * f.blur;
#else
    return f.p;
#endif
}

float share(float x, Footprint f) {
    float outer = twice_integrated(x + f.p, f.blur) + twice_integrated(x - f.p, f.blur);
    float inner = twice_integrated(x + f.q, f.blur) + twice_integrated(x - f.q, f.blur);
    return abs(x) >= reach(f) ? 0.5 * sign(x) : (outer - inner) * f.scale;
}

// Share of the footprint that lies on the pattern along one axis.
float extent(float at, Footprint f, int cells) {
    return share(float(cells) - 0.5 - at, f) - share(-0.5 - at, f);
}
