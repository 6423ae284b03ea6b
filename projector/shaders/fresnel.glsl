// Share of unpolarised light that the boundary reflects, 1 under total reflection: scene/medium.py in float32.
uniform float index_ratio;  // inside / outside

float reflectance(float cosine) {
    float transmitted = 1.0 - index_ratio * index_ratio * (1.0 - cosine * cosine);
    if (transmitted <= 0.0) return 1.0;
    float outside = sqrt(transmitted);
    float s = (index_ratio * cosine - outside) / (index_ratio * cosine + outside);
    float p = (cosine - index_ratio * outside) / (cosine + index_ratio * outside);
    return 0.5 * (s * s + p * p);
}
