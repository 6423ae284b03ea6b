"""Frames + Sequence -> Correspondence: where on the pattern every camera pixel looks, how sure, and why not.

| file | holds |
|---|---|
| `correspondence` | `Correspondence`, `Flag`, `SharedNoise` |
| `decoder` | `decode`; `Decoder`, `estimate_profile`: many captures of one rig |
| `profile` | `RigProfile`: noise and effects of one rig |
| `plan` | a sequence as periods, bits, references, levels; the constraints that it obeys |
| `pipeline` | one capture: sample, noise, effects, tables, maps |
| `frames` | frames validated: type, unit, white level; `Response`; pixels from all over them |
| `noise` | variance of a camera level, from lit pixels |
| `pixels` | levels of one pixel -> place, variance, amplitude, residual, flags; row by row |
| `neighbours` | pixels against their neighbours: aperture, rims, jumps, roughness |
| `rims` | places beside unlit pixels, behind a lens |
| `diagnosis/` | tests of frames against their description; likely mistakes, when asked |
| `codes/` | fringes, bits, orders, look-ups |
| `effects/` | lag, motion, shared noise: one interface |

u along the pattern's columns, v along its rows, integer = pixel centre; sigma in pattern pixels, at least
0.001 where the frames have no noise. An axis without frames is NaN with sigma inf and raises no flag.
A pixel's answer depends on its samples, its neighbourhood of 7 x 7 (11 x 11 beside unlit
pixels) and the camera's noise.
"""

from .correspondence import Correspondence, Flag, SharedNoise
from .decoder import Decoder, decode, estimate_profile
from .diagnosis import Mistake, explain, mirror_coverage, without
from .effects import Effect
from .frames import Response, Settings
from .pipeline import compile_neighbours
from .profile import RigProfile

__all__ = [
    "Correspondence", "Decoder", "Effect", "Flag", "Mistake", "Response", "RigProfile", "Settings",
    "SharedNoise", "compile_neighbours", "decode", "estimate_profile", "explain", "mirror_coverage",
    "without",
]  # fmt: skip
