"""Pixels near the border that the decoder refuses in some draws of noise: what the others tell.

Those that are left are not a sample of all: noise that makes periods agree, or moves a pixel off an entry of
the decoder's table that is refused, also moves what is read. Drawn, as the decoder goes through its periods.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from optolever.decode import BorderTable

from .fringes import DOUBT, MUCH_FINER, Fringe
from .view import Floats

__all__ = ["Kept", "drawn_at_border", "entry_of"]

#: Draws of a pixel at most and at least, numbers drawn for every period about.
MOST, LEAST, NUMBERS = 512, 48, 300_000
Mask = NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class Kept:
    """Of pixels (K,): probability of being refused; mean and rms deviation (cells) of what is read of them
    where they are not."""

    refused: Floats
    mean: Floats
    deviation: Floats


def drawn_at_border(
    groups: list[Fringe],
    shifts: list[Floats],
    variances: list[Floats],
    coord: Floats,
    table: BorderTable,
    extent: int,
    off: float,
    limit: float,
) -> Kept:
    """Of pixels at coord (K,): what they read, less what the decoder takes off by its table.

    shifts (K,): of every fringe, coarse to fine, cells; variances (K,): of their noise; off: distance beyond
    the border from which on a pixel is off the pattern; limit: chi squared of periods that disagree.
    """
    count = int(np.clip(NUMBERS / max(1, len(coord)), LEAST, MOST))
    unit = np.random.default_rng(0).standard_normal((len(groups), count, len(coord)), np.float32)
    noise = (np.sqrt(variance) * one for variance, one in zip(variances, unit, strict=True))
    reads = [shift + own for shift, own in zip(shifts, noise, strict=True)]
    away, agreed = _through(groups, reads, variances, limit)
    place = coord + away
    kept = (
        agreed
        & (place >= -0.5 - off)
        & (place <= extent - 0.5 + off)
        & ~table.refused[entry_of(table, place)]
    )
    error = away - np.interp(place, table.at, table.shift)
    many = np.maximum(kept.sum(axis=0), 1)
    mean = np.sum(error, axis=0, where=kept) / many
    square = np.sum((error - mean) ** 2, axis=0, where=kept) / many
    return Kept(1 - kept.mean(axis=0), mean, np.sqrt(square))


def _through(
    groups: list[Fringe], reads: list[Floats], variances: list[Floats], limit: float
) -> tuple[Floats, Mask]:
    """The coordinate's shift (D, K), from coarse to fine, and whether no step was doubtful or chi squared
    beyond the limit."""
    place, spread = reads[0], variances[0]
    apart, agreed = np.zeros(place.shape), np.ones(place.shape, bool)
    for before, group, read, variance in zip(groups, groups[1:], reads[1:], variances[1:], strict=False):
        period, both = group.period, spread + variance
        step = read - place
        step = step - period * np.rint(step / period)
        apart += step**2 / both
        agreed &= np.abs(step) <= 0.5 * period + both * np.log(DOUBT) / period
        weight = np.ones(both.shape) if MUCH_FINER * period < before.period else spread / both
        place, spread = place + weight * step, weight * variance
    return place, agreed & (apart <= limit)


def entry_of(table: BorderTable, place: Floats) -> NDArray[np.int64]:
    """Of the table, for what is read at places of any shape (cells)."""
    step = table.at[1] - table.at[0]
    return np.asarray(np.floor((place - table.at[0]) / step).clip(0, len(table.at) - 1).astype(np.int64))
