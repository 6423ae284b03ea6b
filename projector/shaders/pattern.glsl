// One frame of a sequence, bit-equal to Sequence.render_frame: levels come from the 1-D tables, in integers.
#ifdef BOTH
uniform usampler2D table_u;  // (columns, frames)
uniform usampler2D table_v;  // (rows, frames)
uniform bool mean;           // mean of both tables instead of their product
#else
uniform usampler2D table;    // (cells, frames): levels as they are shown
#endif
uniform int frame;
uniform int top;             // 0: row 0 is the target's first row; else the target's height, and row 0 is on top

out vec4 level;

uint shown(ivec2 at) {
#ifdef BOTH
    uint u = texelFetch(table_u, ivec2(at.x, frame), 0).r;
    uint v = texelFetch(table_v, ivec2(at.y, frame), 0).r;
    return mean ? (u + v + 1u) / 2u : (u * v + 127u) / 255u;
#else
#ifdef ALONG_U
    return texelFetch(table, ivec2(at.x, frame), 0).r;
#else
    return texelFetch(table, ivec2(at.y, frame), 0).r;
#endif
#endif
}

void main() {
    ivec2 at = ivec2(gl_FragCoord.xy);
    if (top > 0) at.y = top - 1 - at.y;
    level = vec4(vec3(float(shown(at)) / 255.0), 1.0);
}
