"""samples: simulated captures and what is known of them.

| file | holds |
|---|---|
| `demo.py`, `metrics.py` | run_demo: the full chain on a virtual sensor; error metrics |
| `sets.py` | sets of captures as their owners have them |
| `user_patterns.py` | sequences, images and decoders that a user brings: function, folder, file |
| `faults.py` | simulated frames under lag, gamma, flicker and blur of display and light |
| `measurement.py` | what a page, or an explanation, is about |
"""

from .demo import DemoResult, compile_heights, run_demo
from .faults import Faults, levels_of, with_noise
from .measurement import Measurement, Study
from .metrics import height_metrics, rms, sigma_ratio, unflagged
from .sets import SAMPLES, write_sample
from .user_patterns import UserDecoder, UserImages, user_decoder, user_sequence

__all__ = [
    "SAMPLES", "DemoResult", "Faults", "Measurement", "Study", "UserDecoder", "UserImages",
    "compile_heights", "height_metrics", "levels_of", "rms", "run_demo", "sigma_ratio", "unflagged",
    "user_decoder", "user_sequence", "with_noise", "write_sample",
]  # fmt: skip
