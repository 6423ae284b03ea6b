// The mirror's shape: surface(x, y) -> (height, dz/dx, dz/dy) in mm; the same formulas as scene/dent_forms.py and surface.py.

#ifdef DENT
#include "dents.glsl"
#endif
#ifdef GRID
#include "grid.glsl"
#endif
#ifdef FLAT
vec3 surface(vec2 at) {
    return vec3(0.0);
}
#endif
