"""Edge blur: at the mirror's ends light fades, in a pixel or over the lens's blur, and readings shift.

A pixel averages places around its centre, with weights of some variance m2 (px^2). Of a map u in a light A it
reads u + m2 grad u . grad A / A (exact for normal weights). m2 is the variance of the rise of light across
the mirror's ends (a sharp end within a pixel gives about 1/4, which is right: half of it dark, its neighbours
dark and bright, the centre of its light is a quarter away). If the camera is focused on something else, rise
and averaging may differ, so that the shift is not subtracted: it joins the variance.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.stats import trim_mean

from optolever.kernels import inlined, kernel

__all__ = ["Ends", "end_width", "faded", "slope"]

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
#: Lines in the sample along either axis; pixels on either side of an end; fewest ends for a width.
_LINES, _REACH, _FEWEST = 100, 6, 16
#: Residual light before a rise, and range of light after it: shares of the light inside.
_DARK, _EVEN = 0.2, 0.2
#: Levels of a rise one deviation below and above its middle.
_LOW, _HIGH = 0.16, 0.84


class Ends(NamedTuple):
    """m2 and its standard deviation, px^2; 0 and NaN if there are too few ends."""

    variance: float
    sigma: float


def end_width(amplitude: NDArray[Any], flags: NDArray[np.uint16]) -> Ends:
    """m2 from the ends of the mirror. amplitude, flags: (H, W)."""
    turned = ((amplitude, flags), (amplitude.T, flags.T))
    lines = [(light[:, ::way], refused[:, ::way]) for light, refused in turned for way in (1, -1)]
    found = np.concatenate([_rises(*line) for line in lines])
    if len(found) < _FEWEST:
        return Ends(0.0, float("nan"))
    spread = float(np.std(np.sort(found)[len(found) // 10 : len(found) - len(found) // 10]))
    return Ends(max(float(trim_mean(found, 0.1)), 0.0), spread / len(found) ** 0.5)


def _rises(light: NDArray[Any], flags: NDArray[np.uint16]) -> F64:
    """Variances of the rises of light at the first good pixel after flagged ones, along lines."""
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
    # interpolation between pixels widens a rise by a box of one pixel
    return np.asarray(((((high - low) / 2) ** 2 - 1 / 12) * straight)[straight > 0.5])


def _crossing(rise: F64, level: float) -> F64:
    """Positions where rises (K, n) first reach a level."""
    after = np.maximum((rise >= level).argmax(axis=1), 1)
    row = np.arange(len(rise))
    low, high = rise[row, after - 1], rise[row, after]
    return np.asarray(after - np.clip((high - level) / np.maximum(high - low, 1e-6), 0, 1))


@inlined
def slope(before: np.float32, here: np.float32, after: np.float32, per_step: np.float32) -> np.float32:
    """Change per pixel from two equidistant neighbours; from one if the other is NaN; 0 from none."""
    low = before if before == before else here
    high = after if after == after else here
    both = before + after == before + after
    return (np.float32(0.5) if both else np.float32(1)) * per_step * (high - low)


@kernel
def faded(window: F32, k: int, reach: int, light: tuple[F32, F32, F32], m2: np.float32, total: F32) -> None:
    """Add the squared shift by uneven light to the variance of a line (W,).

    window, k: the map around the line, see `centre.windowed`; its slope is taken over `reach` pixels, as the
    nearest ones at an end are shifted, too. light: amplitude of the line and of two others (W,), two pixels
    apart (one colour of a mosaic), on both sides of it or including it.
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
