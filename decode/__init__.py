"""Frames + Sequence -> Correspondence: where on the pattern every camera pixel looks, how sure, and why not.

| file                       | holds                                                                        |
|----------------------------|------------------------------------------------------------------------------|
| `correspondence`           | `Correspondence`, `Flag`                                                     |
| `displacement`             | `Displacement`, `difference` of two captures                                 |
| `decoder`                  | `decode`: which frames ask for which decoder, rows on threads                |
| `rows`, `records`          | work on a block of rows: what the kernels are told, room for them            |
| `survey`, `survey_kernels` | some rows before the rest: footprint, whether neighbours are such            |
| `job`                      | frames, checked; the camera's response, clip level and noise                 |
| `exposures`                | codes under several exposures: each decoded, the best answer per pixel       |
| `plan`, `arrays`           | what has to be computed, sorted by the frames' descriptions; as plain arrays |
| `sample`, `sample_kernels` | some pixels from all over the frames, fetched once                           |
| `noise`, `noise_kernels`   | noise of the camera from what the frames cannot explain                      |
| `variance_kernels`         | variances that outliers do not move, by level                                |
| `response`                 | `Response` of display and camera, inverted before fringes are fitted         |
| `harmonics`                | error that a response leaves: harmonics of the fringes, aliased              |
| `block_kernels`            | blocks of rows, compiled: axes and neighbours while they are in the cache    |
| `ticket_kernels`           | which block a thread takes: numbers that only one of them gets               |
| `axis_kernels`             | one axis over a run of pixels: code and fringes, tile by tile                |
| `tile_lines`               | what they keep of a tile                                                     |
| `write_kernels`            | a tile's coordinates and sigmas on their way into the maps                   |
| `fringe_kernels`           | fringes of a tile, step by step                                              |
| `fit_kernels`              | fringe fit of a tile                                                         |
| `phase_kernels`            | phase of cosine and sine                                                     |
| `pair_kernels`             | two periods of four shifts, fitted, flagged and unwrapped in two loops       |
| `refit_kernels`            | that again for pixels with clipped samples, or with weighed ones             |
| `cell_kernels`             | a code of a tile, step by step                                               |
| `code_kernels`             | bits, code words, cells                                                      |
| `byte_kernels`             | all of that, of 8-bit frames whose bits have inverses, and into the maps     |
| `bits`                     | how much of each bit the camera sees, how wide its edges look                |
| `doubt_kernels`            | probability of a misread bit, and what it does to the place                  |
| `unwrap_kernels`           | fringe orders from several periods or a code, probability of a wrong one     |
| `flag_kernels`             | flags, and the maps that both axes share                                     |
| `display`                  | grey values and border of the display: what they shift                       |
| `display_kernels`          | that, taken off a tile                                                       |
| `blur`, `blur_kernels`     | blur from the contrasts of a few rows                                        |
| `swing`, `swing_kernels`   | or else from how these swing with the place in the cell                      |
| `cells`                    | stairs of the display's cells, taken off                                     |
| `stairs_kernels`, `steep_kernels` | that, pixel by pixel: inverted, or the mean of what it may be         |
| `gathering`, `run_kernels` | blur again, from how stairs gather coordinates at cells                      |
| `table_decoder`            | any known grey values, codes within their cells                              |
| `table_kernels`            | its loops, compiled                                                          |
| `sweep`, `sweep_kernels`   | swept stripes: place of the line that lit a pixel most; lost ones            |
| `raster`, `raster_kernels` | a spot at a raster of places, reduced to two sweeps of a stripe              |
| `raster_faults`            | frames of a raster that are lost, doubled, swapped or another's              |
| `integrity`                | `check`: swapped, lost, repeated and torn frames, named                      |
| `code_jumps`, `code_jump_kernels` | bits that are not those described, told by jumps                      |
| `references`               | how well white and black bound a code's levels                               |
| `stream_kernels`           | coordinates past the caches into their maps, frames ahead into the caches    |
| `neighbour_kernels`        | what neighbours tell of a pixel: bends, steep maps, rows that stray           |
| `mixed_kernels`            | footprints part of which sees nothing, beside a hole or at the border        |
| `survivors`                | pixels that noise let pass where all around them are refused                 |
| `single_shot/`             | `lattice`, `crossed`: one frame against one frame of the mirror at rest      |
| `wave_kernels`             | sine, cosine, exponential                                                    |
| `select_kernels`           | medians and other quantiles                                                  |
| `jit`                      | how kernels are compiled and cached                                          |

u along the pattern's columns, v along its rows, integer = pixel centre; sigma in pattern pixels, at least
0.01 where the frames show no noise. An axis that was not shown is NaN with sigma inf and raises no flag.
"""

from .correspondence import Correspondence, Flag
from .decoder import decode
from .displacement import Displacement, difference
from .display import BorderTable, border_table
from .harmonics import HarmonicError, harmonic_errors
from .integrity import Finding, Integrity, check
from .response import Response
from .single_shot import Crossings, PatternMap, crossed, lattice
from .swing import Contrasts, blur_by_swing, seems_to_swing

__all__ = [
    "BorderTable",
    "Contrasts",
    "Correspondence",
    "Crossings",
    "Displacement",
    "Finding",
    "Flag",
    "HarmonicError",
    "Integrity",
    "PatternMap",
    "Response",
    "blur_by_swing",
    "border_table",
    "check",
    "crossed",
    "decode",
    "difference",
    "harmonic_errors",
    "lattice",
    "seems_to_swing",
]
