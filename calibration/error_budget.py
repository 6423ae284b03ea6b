"""Error budget of the covariance: the independent sources, by name, and the contribution of each.

The error of the estimate is (J^T J)^-1 J^T times the rows' errors, all of variance 1: a row contributes
g g^T, g its column of (J^T J)^-1 J^T. A prior's row has one entry, 1/sigma. The covariance less the priors'
contributions is the captures' noise. Other minima are a separate source.
"""

from fnmatch import fnmatchcase

import numpy as np

from optolever.arrays import Floats

from .adjust import Adjustment

__all__ = ["error_sources"]


_NOISE = "noise of the calibration's captures"
_MINIMA = "other rigs that explain the captures nearly as well"
#: Pattern of parameter names -> source; the first match counts.
_WORDS = {
    "flatness_*.L??": "the flatness of the reference",
    "rest.L??": "the form of the mirror at rest, by its prior",
    "camera.*": "the camera, by its prior",
    "face.*": "the camera's face, by its prior",
    "pattern.b*": "the display's shape, by its prior",
    "pattern.pitch": "the pattern's pitch, by its prior",
    "pattern.*": "the pattern's place, by its prior",
    "*.radius": "the radius of the ball",
    "*": "places of the targets, by their priors",
}


def error_sources(found: Adjustment) -> tuple[tuple[str, ...], Floats]:
    """Names of the s contributing sources, and the contribution of each to `found.covariance`, (s, p, p)."""
    covariance = found.linear
    parts: dict[str, Floats] = {}
    for k, (name, sigma) in enumerate(found.problem.sigmas.items()):
        column = covariance[:, k] / (sigma * max(1.0, found.chi))
        word = next(words for names, words in _WORDS.items() if fnmatchcase(name, names))
        parts[word] = parts.get(word, 0.0) + np.outer(column, column)
    noise = covariance - np.sum(list(parts.values()), axis=0)
    parts = {_NOISE: noise} | parts
    if found.apart.any():
        parts[_MINIMA] = found.apart.T @ found.apart
    return tuple(parts), np.stack(list(parts.values()))
