// One frame of a sequence, bit-equal to Sequence.render_frame: levels come from the 1-D tables, in integers.
uniform usampler2D table_u;  // (columns, frames)
uniform usampler2D table_v;  // (rows, frames)
uniform ivec2 size;          // (columns, rows) of the pattern
uniform int frame;
uniform bool mean;           // mean of both tables instead of their product
uniform int top;             // 0: row 0 is the target's first row; else the target's height, and row 0 is on top

out vec4 level;

void main() {
    ivec2 at = ivec2(gl_FragCoord.xy);
    if (top > 0) at.y = top - 1 - at.y;
    uint gray = 0u;
    if (all(lessThan(at, size)) && at.y >= 0) {
        uint u = texelFetch(table_u, ivec2(at.x, frame), 0).r;
        uint v = texelFetch(table_v, ivec2(at.y, frame), 0).r;
        gray = mean ? (u + v + 1u) / 2u : (u * v + 127u) / 255u;
    }
    level = vec4(vec3(float(gray) / 255.0), 1.0);
}
