// What a camera pixel sees: first meeting of its ray with the mirror, reflection, pattern coordinates.
// What the resting mirror (z = 0) does to the rays is given (rays.py). Followed is how a dent changes it: short ways
// and small turns, so that float32 leaves the sum's rounding only, which favours no direction.
#include "surface.glsl"
#ifdef MEDIUM
#include "fresnel.glsl"
#endif

#ifdef PARALLEL
uniform vec3 direction;
uniform vec4 foot[6];                   // x, y, way from the ray's origin, way on to the end; see exact_sums in rays.py
uniform vec3 end[6];                    // u, v (cells), height over the pattern's plane
#else
uniform sampler2D feet;                 // as foot
uniform sampler2D directions;           // direction, all 0 where the ray does not come, and the end's height
uniform sampler2D ends;                 // the end's u, v, and what float32 left of them
#endif
uniform vec2 first;                     // (column, row) of the target's first pixel
uniform vec3 lowest, highest;           // box of the mirror and the surface's heights, mm
uniform float near;                     // mm: a Newton step this short is the last
uniform vec3 u_axis, v_axis;            // of the pattern, cells per mm
uniform vec3 facing;                    // the pattern's normal
#ifdef MARCH
uniform float steepest;                 // bound on the surface's slope
uniform float shortest;                 // mm: shortest step along a ray that might meet the surface twice
uniform float below;                    // mm: a ray this far below the surface has met it
#endif
#ifdef SEEN
uniform vec2 cells;                     // (columns, rows) of the pattern
#endif

out vec4 seen;  // u, v, light that is passed on (0: nothing is seen), cosine of incidence; for edges u, v, 1 if met

const int STEPS = 40;

struct Ray {
    vec3 at, along;
};

float clearance(Ray ray, float t) {
    vec3 p = ray.at + t * ray.along;
    return p.z - surface(p.xy).x;
}

// Part of the ray inside the box, t >= start; empty where x >= y.
vec2 span(Ray ray, float start) {
    vec2 t = vec2(start, 1e30);
    for (int i = 0; i < 3; ++i) {
        if (ray.along[i] == 0.0) {
            if (ray.at[i] < lowest[i] || ray.at[i] > highest[i]) t = vec2(0.0);
        } else {
            vec2 ends = (vec2(lowest[i], highest[i]) - ray.at[i]) / ray.along[i];
            t = vec2(max(t.x, min(ends.x, ends.y)), min(t.y, max(ends.x, ends.y)));
        }
    }
    return t;
}

// Crossing of the clearance between t.x (above) and t.y (below): Newton inside a shrinking bracket.
float meeting(Ray ray, vec2 t) {
    float at = clamp(0.0, t.x, t.y);
    for (int i = 0; i < STEPS; ++i) {
        vec3 p = ray.at + at * ray.along;
        vec3 h = surface(p.xy);
        float f = p.z - h.x;
        if (f >= 0.0) t.x = at;
        if (f <= 0.0) t.y = at;
        float moved = at - f / (ray.along.z - dot(h.yz, ray.along.xy));
        bool inside = moved >= t.x && moved <= t.y;
        if (!inside) moved = 0.5 * (t.x + t.y);
        bool done = f == 0.0 || (inside && abs(moved - at) <= near) || t.y - t.x <= 0.01 * near;
        at = moved;
        if (done) break;
    }
    return at;
}

#ifdef MARCH
// Bracket of the first place where the ray is below the surface; false where there is none.
bool march(Ray ray, inout vec2 t) {
    float slowest = abs(ray.along.z) + steepest * length(ray.along.xy);
    float at = t.x;
    while (true) {
        float f = clearance(ray, at);
        if (f < -below) {
            t.y = at;
            return true;
        }
        t.x = at;
        if (at >= t.y) return false;
        at = min(at + max(f / slowest, shortest), t.y);
    }
    return false;
}

bool steady(vec3 along, float sign) {
    return sign * along.z > steepest * length(along.xy);
}
#endif

bool meet(Ray ray, float start, out float at) {
    vec2 t = span(ray, start);
    if (t.x >= t.y || clearance(ray, t.x) < -near) return false;
#ifdef MARCH
    if (steady(ray.along, -1.0)) {
        if (clearance(ray, t.y) > near) return false;
    } else if (!march(ray, t)) return false;
#else
    if (clearance(ray, t.y) > near) return false;
#endif
    at = meeting(ray, t);
    return true;
}

void main() {
    seen = vec4(0.0);
    Ray ray;
    float t;
#ifdef PARALLEL
    vec3 pixel = vec3(1.0, gl_FragCoord.xy - 0.5 + first);
    vec4 on_rest = mat3x4(foot[0], foot[1], foot[2]) * pixel + mat3x4(foot[3], foot[4], foot[5]) * pixel;
    vec3 resting = mat3(end[0], end[1], end[2]) * pixel, correction = mat3(end[3], end[4], end[5]) * pixel;
    ray = Ray(vec3(on_rest.xy, 0.0), direction);
    float height = resting.z + correction.z;
#else
    ivec2 texel = ivec2(gl_FragCoord.xy);
    vec4 on_rest = texelFetch(feet, texel, 0), towards = texelFetch(directions, texel, 0);
    if (towards.z == 0.0) return;
    vec2 resting = texelFetch(ends, texel, 0).xy, correction = texelFetch(ends, texel, 0).zw;
    ray = Ray(vec3(on_rest.xy, 0.0), towards.xyz);
    float height = towards.w;
#endif
    if (!meet(ray, -on_rest.z, t)) return;
    vec3 point = ray.at + t * ray.along;
    vec2 slope = surface(point.xy).yz;
    float steepness = dot(slope, slope), size = sqrt(1.0 + steepness);
    vec3 normal = vec3(-slope, 1.0) / size, lean = vec3(-slope, -steepness / (size + 1.0)) / size;  // normal - z
    float cosine = -dot(ray.along, normal);
    vec3 leaving = ray.along + 2.0 * cosine * normal;
    // The resting way's end, moved: its foot by t along the ray, its direction by the lean of the normal.
    vec3 shift = t * ray.along - 2.0 * on_rest.w * (dot(ray.along, lean) * normal + ray.along.z * lean);
    float further = -(height + dot(facing, shift)) / dot(facing, leaving), reach = on_rest.w + further;
    vec3 moved = shift + further * leaving;
    vec2 uv = resting.xy + (correction.xy + vec2(dot(u_axis, moved), dot(v_axis, moved)));
#ifdef SEEN
    bool on_cells = all(greaterThanEqual(uv, vec2(-0.5))) && all(lessThanEqual(uv, cells - 0.5));
    if (!(reach > 0.0 && cosine > 0.0 && on_cells)) return;
#ifdef MARCH
    Ray left = Ray(point, leaving);
    vec2 way = vec2(0.0, min(span(left, 0.0).y, reach));
    if (!steady(leaving, 1.0) && march(left, way)) return;
#endif
#ifdef MEDIUM
    seen = vec4(uv, reflectance(cosine), cosine);
#else
    seen = vec4(uv, 1.0, cosine);
#endif
#else
#ifdef MEDIUM
    seen = vec4(uv, reach > 0.0 ? reflectance(abs(cosine)) : 0.0, cosine);
#else
    seen = vec4(uv, reach > 0.0 ? 1.0 : 0.0, cosine);
#endif
#endif
}
