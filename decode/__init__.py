"""Frames + Sequence -> Correspondence: where on the pattern every camera pixel looks, how sure, and why not.

| file             | holds                                                                                  |
|------------------|----------------------------------------------------------------------------------------|
| `correspondence` | `Correspondence`, `Flag`; `Displacement`, `difference` of two captures                 |
| `decoder`        | `decode`; `Decoder`, `estimate_profile`: many captures of one rig                      |
| `rig_profile`    | `RigProfile`: what the frames of one rig have in common; `Settings`                    |
| `prepare`        | frames -> profile -> tables, once                                                      |
| `apply`          | frames -> Correspondence by a prepared decoder, without an estimate                    |
| `sampled`        | statistics of sample pixels, to test whether a profile still holds                     |
| `axis`           | one axis: estimates from a sample, choice of decoding steps, their chain over rows     |
| `estimate`       | `Estimate`: intermediate result of one axis for a block of rows                        |
| `plan`           | a sequence as periods, bits, references, levels; the constraints that it obeys         |
| `frames`         | frames validated, white level, response; pixels from all over them                     |
| `float_frames`   | frames in floating point: their unit, pixels that are not finite                       |
| `response`       | `Response` of display and camera, inverted before fringes are fitted                   |
| `flags`          | flags, made once; maps that both axes share                                            |
| `display`        | display model: cell, footprint, blur, rounded grey values                              |
| `spatial`        | checks against neighbours: edges, partial footprints, outliers                         |
| `centre`         | from the mean over a pixel to its centre: curvature and light gradient                 |
| `exposures`      | codes under several exposures: each decoded, the best answer per pixel                 |
| `codes/`         | frames of an axis -> `Estimate`: fringes, orders, bits, look-ups                       |
| `profile/`       | what frames of one rig have in common: noise, lag, cells, lens, border                 |
| `checks/`        | hypotheses about frames: swapped, lost, replaced                                       |

u along the pattern's columns, v along its rows, integer = pixel centre; sigma in pattern pixels, at least
0.01 where the frames have no noise. An axis without frames is NaN with sigma inf and raises no flag.
"""

from optolever.arguments import check_face

from .checks.integrity import Integrity, check
from .checks.spoilt import Finding
from .correspondence import Correspondence, Displacement, Flag, SharedNoise, difference
from .decoder import Decoder, decode, estimate_profile
from .response import Response
from .rig_profile import Effect, RigProfile, Settings

__all__ = [
    "Correspondence",
    "Decoder",
    "Displacement",
    "Effect",
    "Finding",
    "Flag",
    "Integrity",
    "Response",
    "RigProfile",
    "Settings",
    "SharedNoise",
    "check",
    "decode",
    "difference",
    "estimate_profile",
]

check_face(__name__)
