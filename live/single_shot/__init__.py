"""One frame against one frame of the mirror at rest, for mirrors that move.

| file             | holds                                                                                  |
|------------------|----------------------------------------------------------------------------------------|
| `crossed`        | `crossed`: Displacement of every pixel from a crossed fringe                           |
| `window_fit`     | both fringes fitted at once within a Gaussian window                                   |
| `prior`          | map of the mirror at rest, pixels with a fringe, and the noise there                   |
"""

from .crossed import crossed
from .prior import PatternMap

__all__ = ["PatternMap", "crossed"]
