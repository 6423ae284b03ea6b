"""Where the mirror ends light fades, in a pixel or over the lens's blur: pixels there see more of one side.

A pixel sees places around its own, with weights of some variance m2 (px^2). Of a map u in a light A it reads
u + m2 grad u . grad A / A (exact for normal weights). m2 is how wide light rises across the mirror's ends (a
sharp end within a pixel reads about 1/4, as it should: half of it dark, its neighbours dark and bright, the
centre of its light is a quarter away). Where a camera is focused on something else rise and mixing need not
agree, so that the shift is not taken off: it joins the variance.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.stats import trim_mean

from optolever.kernels import inlined, kernel

__all__ = ["Ends", "end_width", "faded", "slope"]

F64 = NDArray[np.float64]
#: Lines that are looked at along either axis; pixels on either side of an end; ends that tell a width.
_LINES, _REACH, _FEWEST = 100, 6, 16
#: Light that is left where a rise begins, and range where it has ended: shares of the light inside.
_DARK, _EVEN = 0.2, 0.2
#: Shares at which a rise is one deviation below and above its middle.
_LOW, _HIGH = 0.16, 0.84


class Ends(NamedTuple):
    """m2 and its standard deviation, px^2; 0 and NaN where too few ends tell."""

    variance: float
    sigma: float


def end_width(amplitude: NDArray[Any], flags: NDArray[np.uint16]) -> Ends:
    """m2 by the ends of the mirror. amplitude, flags: (H, W)."""
    turned = ((amplitude, flags), (amplitude.T, flags.T))
    lines = [(light[:, ::way], refused[:, ::way]) for light, refused in turned for way in (1, -1)]
    found = np.concatenate([_rises(*line) for line in lines])
    if len(found) < _FEWEST:
        return Ends(0.0, float("nan"))
    spread = float(np.std(np.sort(found)[len(found) // 10 : len(found) - len(found) // 10]))
    return Ends(max(float(trim_mean(found, 0.1)), 0.0), spread / len(found) ** 0.5)


def _rises(light: NDArray[Any], flags: NDArray[np.uint16]) -> F64:
    """Variances across the ends from which on pixels of a line are good."""
    if min(light.shape) < 2 * _REACH:
        return np.zeros(0)
    every = slice(1, -1, max(1, len(light) // _LINES))
    good = flags[every] == 0
    line, first = np.divmod(np.flatnonzero(good[:, 1:] > good[:, :-1]), light.shape[1] - 1)
    line, first = np.arange(len(light))[every][line], first + 1
    kept = (first >= _REACH) & (first < light.shape[1] - _REACH)
    line, at = line[kept, None], first[kept, None] + np.arange(-_REACH, _REACH + 1)
    rise = light[line, at].astype(np.float64)
    rise /= np.maximum(rise[:, -3:].mean(axis=1), 1e-6)[:, None]
    whole = (flags[line, at[:, -3:]] == 0).all(axis=1) & (np.ptp(rise[:, -3:], axis=1) < _EVEN)
    whole &= rise[:, :2].max(axis=1) < _DARK
    line, at, rise = line[whole], at[whole], rise[whole]
    low, high = _crossing(rise, _LOW), _crossing(rise, _HIGH)
    middle = np.take_along_axis(at, np.rint((low + high) / 2).astype(int)[:, None], 1)
    along = light[line, middle + 1] - light[line, middle - 1]
    across = light[line + 1, middle] - light[line - 1, middle]
    straight = (along**2 / np.maximum(along**2 + across**2, 1e-12))[:, 0]  # cos^2 of the end's slant
    # between samples of pixels a rise is a box of one wider
    return np.asarray(((((high - low) / 2) ** 2 - 1 / 12) * straight)[straight > 0.5])


def _crossing(rise: F64, level: float) -> F64:
    """Where rises (K, n) first reach a level."""
    after = np.maximum((rise >= level).argmax(axis=1), 1)
    row = np.arange(len(rise))
    low, high = rise[row, after - 1], rise[row, after]
    return np.asarray(after - np.clip((high - level) / np.maximum(high - low, 1e-6), 0, 1))


@inlined
def slope(before: Any, here: Any, after: Any, per_step: Any) -> Any:
    """Change per pixel by two neighbours, equally far; by one where the other is refused (NaN), 0 by none."""
    low = before if before == before else here
    high = after if after == after else here
    both = before + after == before + after
    return (np.float32(0.5) if both else np.float32(1)) * per_step * (high - low)


@kernel
def faded(window: Any, k: Any, reach: Any, light: Any, m2: Any, total: Any) -> None:
    """What uneven light shifts in a line (W,), into its variance.

    window, k: the map around the line, see `centre.windowed`; its slope is taken over `reach` pixels, as
    those next to an end are shifted themselves. light: amplitude of the line and of two others (W,), between
    which it is or one of which it is, two pixels apart (behind a mosaic of one colour).
    """
    lit, up, down = light
    half, per_step, size = np.float32(0.5), np.float32(1) / np.float32(reach), total.size
    line = window[k, reach : reach + size]
    left, right = window[k, :size], window[k, 2 * reach : 2 * reach + size]
    above, below = window[k - reach, reach : reach + size], window[k + reach, reach : reach + size]
    along = np.empty(size, np.float32)
    for x in range(1, size - 1):
        along[x] = lit[x + 1] - lit[x - 1]
    along[0], along[size - 1] = along[1], along[size - 2]
    for x in range(size):
        shift = slope(left[x], line[x], right[x], per_step) * along[x]
        shift += slope(above[x], line[x], below[x], per_step) * (down[x] - up[x])
        shift *= half * m2 / max(lit[x], np.float32(1e-6))
        total[x] += shift * shift if shift == shift else np.float32(0)
