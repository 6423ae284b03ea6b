"""Do the frames agree with their description and its order? Tests of every capture; after a refusal, causes.

| file      | holds                                                                            |
|-----------|----------------------------------------------------------------------------------|
| `tests`   | the table of tests: figure, limit, words, pixels refused                         |
| `windows` | bits against fringes, residuals: faults in a part of the image                   |
| `blocks`  | small blocks of the image, decoded plainly: share of pixels with a place         |
| `explain` | the likeliest mistakes of an order or a description                              |
| `without` | a code without some of its pictures                                              |
| `too_few` | why few pixels are good; how much of the image the mirror fills                  |

Nothing here changes how frames are decoded: a test that fails refuses pixels, and `explain` prints names.
"""

from .explain import Mistake, explain
from .tests import judged
from .too_few import mirror_coverage
from .without import without

__all__ = ["Mistake", "explain", "judged", "mirror_coverage", "without"]
