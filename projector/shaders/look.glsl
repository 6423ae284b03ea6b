// Irradiance of up to four frames per attachment: the cells under the footprint, weighted by their shares.
#include "footprint.glsl"

uniform sampler2D seen;        // u, v, light that the mirror passes on (0: nothing is seen), cosine of incidence
uniform sampler2D edges_col;   // u, v, 1 if met, half a pixel before and behind each pixel's centre: one more column
uniform sampler2D edges_row;   // likewise: one more row
uniform ivec2 cells;           // (columns, rows) of the pattern
#ifdef BOTH
uniform usampler2D table_u;    // (columns, frames / 4): levels
uniform usampler2D table_v;    // (rows, frames / 4)
uniform sampler2D response;    // (256, 1): light of a level, 0..1
#else
uniform sampler2D table;       // (cells, frames / 4): light of the cells, 0..1
#endif

layout(location = 0) out vec4 irradiance[$QUADS];

// Movement over the pattern (cells) from edge to edge of the pixel; twice the half of it where one edge sees nothing.
vec2 moved(vec2 centre, vec4 before, vec4 behind) {
    if (before.z > 0.0 && behind.z > 0.0) return abs(behind.xy - before.xy);
    if (before.z > 0.0) return 2.0 * abs(centre - before.xy);
    return behind.z > 0.0 ? 2.0 * abs(behind.xy - centre) : vec2(0.0);
}

ivec2 under(float at, Footprint f, int count) {
    float far = reach(f);
    return ivec2(max(0, int(ceil(at - far - 0.5))), min(count - 1, int(floor(at + far + 0.5))));
}

void main() {
    ivec2 at = ivec2(gl_FragCoord.xy);
    vec4 look = texelFetch(seen, at, 0);
    vec4 sums[$QUADS];
    for (int n = 0; n < $QUADS; ++n) sums[n] = vec4(0.0);
    if (look.z > 0.0) {
        vec2 by_col = moved(look.xy, texelFetch(edges_col, at, 0), texelFetch(edges_col, at + ivec2(1, 0), 0));
        vec2 by_row = moved(look.xy, texelFetch(edges_row, at, 0), texelFetch(edges_row, at + ivec2(0, 1), 0));
        Footprint fu = footprint(vec2(by_col.x, by_row.x)), fv = footprint(vec2(by_col.y, by_row.y));
#ifdef BOTH
        ivec2 along_u = under(look.x, fu, cells.x), along_v = under(look.y, fv, cells.y);
        for (int j = along_v.x; j <= along_v.y; ++j) {
            float weight_v = share(float(j) + 0.5 - look.y, fv) - share(float(j) - 0.5 - look.y, fv);
            for (int k = along_u.x; k <= along_u.y; ++k) {
                float weight_u = share(float(k) + 0.5 - look.x, fu) - share(float(k) - 0.5 - look.x, fu);
                for (int n = 0; n < $QUADS; ++n) {
                    uvec4 u = texelFetch(table_u, ivec2(k, n), 0), v = texelFetch(table_v, ivec2(j, n), 0);
#ifdef MEAN
                    ivec4 level = ivec4((u + v + 1u) / 2u);
#else
                    ivec4 level = ivec4((u * v + 127u) / 255u);
#endif
                    vec4 light;
                    for (int c = 0; c < 4; ++c) light[c] = texelFetch(response, ivec2(level[c], 0), 0).r;
                    sums[n] += weight_u * weight_v * light;
                }
            }
        }
        float passed = look.z;
#else
#ifdef ALONG_U
        Footprint f = fu;
        float centre = look.x, passed = look.z * extent(look.y, fv, cells.y);
        ivec2 span = under(centre, f, cells.x);
#else
        Footprint f = fv;
        float centre = look.y, passed = look.z * extent(look.x, fu, cells.x);
        ivec2 span = under(centre, f, cells.y);
#endif
        float left = share(float(span.x) - 0.5 - centre, f);
        for (int k = span.x; k <= span.y; ++k) {
            float right = share(float(k) + 0.5 - centre, f);
            for (int n = 0; n < $QUADS; ++n) sums[n] += (right - left) * texelFetch(table, ivec2(k, n), 0);
            left = right;
        }
#endif
        for (int n = 0; n < $QUADS; ++n) sums[n] *= passed;
    }
    for (int n = 0; n < $QUADS; ++n) irradiance[n] = sums[n];
}
