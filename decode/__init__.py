"""Frames + Sequence -> Correspondence: where on the pattern every camera pixel looks, how sure, and why not.

| file             | holds                                                                                  |
|------------------|----------------------------------------------------------------------------------------|
| `correspondence` | `Correspondence`, `Flag`; `Displacement`, `difference` of two captures                 |
| `decoder`        | `decode`: the steps, on one screen                                                     |
| `axis`           | which steps the frames of one axis ask for, chained over a block of rows               |
| `estimate`       | `Estimate`: what a block of rows tells of one axis on its way                          |
| `plan`           | a sequence as periods, bits, references, levels; the constraints that it obeys         |
| `frames`         | frames validated, white level, response; pixels from all over them                     |
| `noise`          | photon transfer from what no scene can make of the frames; pixels that see the pattern |
| `shared_noise`   | what pixels of a row, of a column, of a whole frame have in common of the noise        |
| `moved`          | how far whole frames are off: a rig that shakes, or moves steadily                     |
| `unlike`         | a display on its way when the camera exposes; misfit within and between fringes        |
| `response`       | `Response` of display and camera, inverted before fringes are fitted                   |
| `phase`          | N-step least squares: phase, variance, amplitude, chi2                                 |
| `unwrap`         | fringe orders from coarse to fine, from a code or, of close periods, by a table        |
| `gray`           | bits -> word -> cell, posterior of a wrong bit                                         |
| `bit_levels`     | what cells show of bits behind a blur; posterior of pixels with weak bits               |
| `lookup`, `lookup_tables` | any known levels: stripes, free grey values, codes within cells; tables |
| `lookup_kernels`, `lookup_light` | its loops, batch by batch; rows of frames as they read them           |
| `lookup_search`  | its codewords; one pixel among them                                                    |
| `flags`          | flags, made once; maps that both axes share                                            |
| `display`        | one model of what a display does: cell, footprint, blur, rounded grey values            |
| `pixelation`     | what its cells shift: the blur that a map tells, taken off; what stays unsure           |
| `spatial`        | what neighbours tell: edges, partial footprints, strays                                |
| `centre`         | from the mean over a pixel to its centre: curvature and light inside of it             |
| `lens`           | a lens's blur, by the contrast that it takes from fringes where the map is steep       |
| `ends`           | what a lens's blur mixes into pixels beside the mirror's ends                          |
| `edge_lines`     | outermost lines of the image that a camera's filter made of what it repeats beyond it  |
| `border`         | light that is missing beside the display's border, and how far that tells a pixel sees |
| `integrity`      | `check`: swapped, lost, repeated, replaced and torn frames, named                      |
| `spoilt`         | `Finding`: frames that a code can do without, pixels that a wrong one could have spoilt |
| `sample_fit`     | what a single pixel's samples say of each axis, for it                                 |
| `exposures`      | codes under several exposures: each decoded, the best answer per pixel                 |
| `single_shot/`   | `lattice`, `crossed`: one frame against one at rest                                    |

u along the pattern's columns, v along its rows, integer = pixel centre; sigma in pattern pixels, at least
0.01 where the frames show no noise. An axis that was not shown is NaN with sigma inf and raises no flag.
"""

from optolever.arguments import check_face

from .correspondence import Correspondence, Displacement, Flag, SharedNoise, difference
from .decoder import decode
from .integrity import Integrity, check
from .response import Response
from .single_shot import Crossings, PatternMap, crossed, lattice
from .spoilt import Finding

__all__ = [
    "Correspondence",
    "Crossings",
    "Displacement",
    "Finding",
    "Flag",
    "Integrity",
    "PatternMap",
    "Response",
    "SharedNoise",
    "check",
    "crossed",
    "decode",
    "difference",
    "lattice",
]

check_face(__name__)
