"""Where stairs are so steep that they have no inverse: what the mean of all likely places leaves.

On a tread of a sharp display many places are read as the same coordinate. The decoder answers with their
mean; its variance over a cell depends on the footprint alone, and is tabled for it.
"""

import numpy as np

from .cells import stairs
from .view import Floats

__all__ = ["unresolved"]

#: Largest slope of stairs that the decoder inverts; of noise above NOISY (cells).
GENTLE, UNEVEN, NOISY = 0.8, 0.4, 0.02
#: Places in a cell, footprints (cells) that are tabled.
PLACES, WIDTHS = 128, np.linspace(0.0, 1.6, 33)


def unresolved(
    periods: list[float], shares: list[float], blur: float, widths: tuple[Floats, Floats], noise: Floats
) -> Floats:
    """Variance (cells^2) of the coordinate where stairs are steep, 0 where they are gentle.

    periods, shares: what the coordinate is the mean of; widths: of pixels; noise: rms, cells.
    """
    wide = np.maximum(*widths)
    seen = np.isfinite(noise) & np.isfinite(wide)
    if not seen.any():
        return np.zeros(wide.shape)
    usual = float(np.median(noise[seen]))
    table = [_variance(periods, shares, blur, width, usual) for width in WIDTHS]
    return np.asarray(np.interp(np.nan_to_num(wide, nan=WIDTHS[-1]), WIDTHS, table))


def _variance(periods: list[float], shares: list[float], blur: float, width: float, noise: float) -> float:
    """Mean over a cell of the variance of the places that are read alike."""
    place = (np.arange(PLACES) + 0.5) / PLACES
    box = (np.full(PLACES, max(width, 1e-6)),)
    error = sum(
        share * stairs(place, box, blur, period) for period, share in zip(periods, shares, strict=True)
    )
    read = place + error
    rise = np.diff(read, append=read[0] + 1)
    if np.abs(rise * PLACES - 1).max() < (UNEVEN if noise > NOISY else GENTLE):
        return 0.0
    off = read[:, None] - read[None, :]
    cells = np.rint(off)
    likely = np.exp(-0.5 * (off - cells) ** 2 / (noise**2 + rise**2 / 12)) / np.sqrt(noise**2 + rise**2 / 12)
    away = place[None, :] + cells - place[:, None]
    likely /= likely.sum(axis=1, keepdims=True)
    mean = (likely * away).sum(axis=1)
    return float(((likely * away**2).sum(axis=1) - mean**2).mean())
