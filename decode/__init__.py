"""Frames + Sequence -> Correspondence: where on the pattern every camera pixel looks, how sure, and why not.

| file             | holds                                                                                  |
|------------------|----------------------------------------------------------------------------------------|
| `correspondence` | `Correspondence`, `Flag`; `Displacement`, `difference` of two captures                 |
| `decoder`        | `decode`; `Decoder`, `estimate_profile`: many captures of one rig                      |
| `rig_profile`    | `RigProfile`: what the frames of one rig have in common; `Settings`                    |
| `prepare`        | frames -> profile -> tables, once                                                      |
| `apply`          | frames -> Correspondence by a prepared decoder, without an estimate                    |
| `sampled`        | what some pixels show: whether a profile still holds                                   |
| `axis`           | what a sample tells of one axis, which steps its frames ask for, chained over rows     |
| `estimate`       | `Estimate`: what a block of rows tells of one axis on its way                          |
| `plan`           | a sequence as periods, bits, references, levels; the constraints that it obeys         |
| `frames`         | frames validated, white level, response; pixels from all over them                     |
| `float_frames`   | frames in floating point: their unit, pixels that are not finite                       |
| `response`       | `Response` of display and camera, inverted before fringes are fitted                   |
| `flags`          | flags, made once; maps that both axes share                                            |
| `display`        | one model of what a display does: cell, footprint, blur, rounded grey values            |
| `spatial`        | what neighbours tell: edges, partial footprints, strays                                |
| `centre`         | from the mean over a pixel to its centre: curvature and light inside of it             |
| `exposures`      | codes under several exposures: each decoded, the best answer per pixel                 |
| `codes/`         | frames of an axis -> `Estimate`: fringes, orders, bits, look-ups                       |
| `profile/`       | what frames of one rig have in common: noise, lag, cells, lens, border                 |
| `checks/`        | hypotheses about frames: swapped, lost, replaced                                       |
| `single_shot/`   | `lattice`, `crossed`: one frame against one at rest                                    |

u along the pattern's columns, v along its rows, integer = pixel centre; sigma in pattern pixels, at least
0.01 where the frames show no noise. An axis that was not shown is NaN with sigma inf and raises no flag.
"""

from optolever.arguments import check_face

from .checks.integrity import Integrity, check
from .checks.spoilt import Finding
from .correspondence import Correspondence, Displacement, Flag, SharedNoise, difference
from .decoder import Decoder, decode, estimate_profile
from .response import Response
from .rig_profile import Effect, RigProfile, Settings
from .single_shot import Crossings, PatternMap, crossed, lattice

__all__ = [
    "Correspondence",
    "Crossings",
    "Decoder",
    "Displacement",
    "Effect",
    "Finding",
    "Flag",
    "Integrity",
    "PatternMap",
    "Response",
    "RigProfile",
    "Settings",
    "SharedNoise",
    "check",
    "crossed",
    "decode",
    "difference",
    "estimate_profile",
    "lattice",
]

check_face(__name__)
