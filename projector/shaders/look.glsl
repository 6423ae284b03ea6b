// Irradiance of up to four frames per attachment: the cells under the footprint, weighted by their shares.
#include "footprint.glsl"

uniform sampler2D seen;        // u, v, light that the mirror passes on (0: nothing is seen), cosine of incidence
uniform sampler2D edges_col;   // u, v, light (0: not met), half a pixel before and behind each pixel's centre: one more column
uniform sampler2D edges_row;   // likewise: one more row
uniform ivec2 cells;           // (columns, rows) of the pattern
#ifdef BOTH
uniform usampler2D table_u;    // (columns, frames / 4): levels
uniform usampler2D table_v;    // (rows, frames / 4)
uniform sampler2D response;    // (256, 1): light of a level, 0..1
#else
uniform sampler2D table;       // (cells, frames / 4): light of the cells, 0..1
#endif

layout(location = 0) out vec4 irradiance[QUADS];

// Movement over the pattern (cells) from edge to edge of the pixel; twice the half of it where one edge sees nothing.
vec2 moved(vec2 centre, vec4 before, vec4 behind) {
    if (before.z > 0.0 && behind.z > 0.0) return behind.xy - before.xy;
    if (before.z > 0.0) return 2.0 * (centre - before.xy);
    return behind.z > 0.0 ? 2.0 * (behind.xy - centre) : vec2(0.0);
}

// Mean over the pixel's light less its centre, along one direction (Simpson's rule).
vec2 mean_beside(vec4 centre, vec4 before, vec4 behind) {
    if (before.z <= 0.0 || behind.z <= 0.0) return vec2(0.0);
    vec2 moment = before.z * (before.xy - centre.xy) + behind.z * (behind.xy - centre.xy);
    return moment / (before.z + 4.0 * centre.z + behind.z);
}

ivec2 under(float at, Footprint f, int count) {
    float far = reach(f);
    return ivec2(max(0, int(ceil(at - far - 0.5))), min(count - 1, int(floor(at + far + 0.5))));
}

#ifdef BOTH
vec4 light_of(uvec4 u, uvec4 v) {
#ifdef MEAN
    ivec4 level = ivec4((u + v + 1u) / 2u);
#else
    ivec4 level = ivec4((u * v + 127u) / 255u);
#endif
    vec4 light;
    for (int c = 0; c < 4; ++c) light[c] = texelFetch(response, ivec2(level[c], 0), 0).r;
    return light;
}

// All cells under a footprint, shares multiplied.
void add_cells(vec2 at, Footprint fu, Footprint fv, float scale, inout vec4 sums[QUADS]) {
    ivec2 along_u = under(at.x, fu, cells.x), along_v = under(at.y, fv, cells.y);
    for (int j = along_v.x; j <= along_v.y; ++j) {
        float weight_v = scale * (share(float(j) + 0.5 - at.y, fv) - share(float(j) - 0.5 - at.y, fv));
        for (int k = along_u.x; k <= along_u.y; ++k) {
            float weight_u = share(float(k) + 0.5 - at.x, fu) - share(float(k) - 0.5 - at.x, fu);
            for (int n = 0; n < QUADS; ++n) {
                uvec4 u = texelFetch(table_u, ivec2(k, n), 0), v = texelFetch(table_v, ivec2(j, n), 0);
                sums[n] += weight_u * weight_v * light_of(u, v);
            }
        }
    }
}
#else
void add_cells(float at, Footprint f, int count, float scale, inout vec4 sums[QUADS]) {
    ivec2 span = under(at, f, count);
    float left = share(float(span.x) - 0.5 - at, f);
    for (int k = span.x; k <= span.y; ++k) {
        float right = share(float(k) + 0.5 - at, f);
        for (int n = 0; n < QUADS; ++n) sums[n] += scale * (right - left) * texelFetch(table, ivec2(k, n), 0);
        left = right;
    }
}
#endif

void main() {
    ivec2 at = ivec2(gl_FragCoord.xy);
    vec4 look = texelFetch(seen, at, 0);
    vec4 sums[QUADS];
    for (int n = 0; n < QUADS; ++n) sums[n] = vec4(0.0);
    if (look.z > 0.0) {
        vec4 left = texelFetch(edges_col, at, 0), right = texelFetch(edges_col, at + ivec2(1, 0), 0);
        vec4 above = texelFetch(edges_row, at, 0), below = texelFetch(edges_row, at + ivec2(0, 1), 0);
        vec2 by_col = moved(look.xy, left, right), by_row = moved(look.xy, above, below);
        look.xy += mean_beside(look, left, right) + mean_beside(look, above, below);
#ifdef BOTH
        // The shares' product leaves out that u and v vary together over a footprint that lies askew: cut it up.
        int parts = abs(by_col.x * by_col.y + by_row.x * by_row.y) > ASKEW ? PARTS : 1;
        float cut = 1.0 / float(parts);
        Footprint fu = footprint(cut * vec2(by_col.x, by_row.x)), fv = footprint(cut * vec2(by_col.y, by_row.y));
        for (int i = 0; i < parts; ++i) {
            for (int j = 0; j < parts; ++j) {
                vec2 shift = (cut * (vec2(i, j) + 0.5) - 0.5);
                add_cells(look.xy + shift.x * by_col + shift.y * by_row, fu, fv, look.z * cut * cut, sums);
            }
        }
#else
        Footprint fu = footprint(vec2(by_col.x, by_row.x)), fv = footprint(vec2(by_col.y, by_row.y));
#ifdef ALONG_U
        add_cells(look.x, fu, cells.x, look.z * extent(look.y, fv, cells.y), sums);
#else
        add_cells(look.y, fv, cells.y, look.z * extent(look.x, fu, cells.x), sums);
#endif
#endif
    }
    for (int n = 0; n < QUADS; ++n) irradiance[n] = sums[n];
}
