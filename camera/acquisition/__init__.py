"""acquisition: an image for every pattern, of the right pattern.

| file | holds |
|---|---|
| `clocks.py` | stamps of cameras as host times |
| `arrivals.py` | the images of a running camera as they come, with their times |
| `acquire.py` | the first complete image of every pattern after it has settled |
| `sync_result.py`, `synchronise.py` | latency, settling, shutter; measured by flips |
| `exposure.py` | exposure by white and black |
| `aim.py` | aim and focus by white and black |
"""

from .acquire import Taken, acquire
from .aim import Aim, aim
from .arrivals import Arrivals
from .clocks import ClockMap, Stamp
from .exposure import Contrast, choose_exposure, contrast
from .sync_result import SAFE_WAIT_S, Timing
from .synchronise import FlipRecord, fit_timing, sync_notices, synchronise

__all__ = [
    "SAFE_WAIT_S", "Aim", "Arrivals", "ClockMap", "Contrast", "FlipRecord",
    "Stamp", "Taken", "Timing", "acquire", "aim", "choose_exposure", "contrast", "fit_timing",
    "sync_notices", "synchronise",
]  # fmt: skip
