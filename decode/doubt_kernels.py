"""Compiled: how doubtful the bits of a code are at one pixel, by Bayes from margin, noise and contrast."""

import math
from typing import Any

import numpy as np

from .jit import inline_kernel, leaf_kernel, pasted_kernel
from .records import Camera, CellLines, CodeRecord

__all__ = [
    "BRIGHTER",
    "FROM_EXTREMES",
    "FROM_PAIRS",
    "FROM_WHITE_BLACK",
    "SIX",
    "lone",
    "misread",
    "surely",
    "uneven",
]

#: Where the threshold of bits without inverse, the contrast and the offset come from.
FROM_WHITE_BLACK, FROM_PAIRS, FROM_EXTREMES = 0, 1, 2
#: Squared margin over variance beyond which a bit is certain: 6 sigma, 1e-9.
_CERTAIN, SIX = np.float32(36.0), np.float32(6.0)
#: Sums of a bit and its inverse that differ by more half contrasts: a sample was lit by something else. Two
#: half contrasts flip a bit, fewer do where it is near its edge; real displays are uneven by a tenth.
_ODD = np.float32(0.4)
#: Rms error of a threshold half way, in half contrasts, where white is clipped and may be a fifth brighter.
BRIGHTER = np.float32(0.05)

#: Variance and contrast over noise that are reckoned with at least; 1 / sqrt(2), 1 / sqrt(2 pi).
_LEAST_SPREAD, _LOWEST, _HALF_ROOT, _PEAK = 1e-12, 1e-3, math.sqrt(0.5), 1 / math.sqrt(2 * math.pi)


@inline_kernel
def lone(source: Any) -> Any:
    """Variance of a margin without inverse over that of a sample: the threshold has noise, too."""
    return np.float32(1.0) if source == FROM_EXTREMES else np.float32(1.5)


@pasted_kernel
def uneven(apart: Any, half: Any, noise: Any) -> Any:
    """Whether the sums of bits and their inverses differ; noise: six sigma."""
    return apart > _ODD * half + noise


@pasted_kernel
def surely(margin: Any, variance: Any, systematic: Any) -> Any:
    """Whether a bit of that margin is certain; systematic: error."""
    return margin * margin > _CERTAIN * (variance + systematic * systematic)


@leaf_kernel
def _tail(x: float) -> float:
    """Q(x), what a normal distribution has beyond x."""
    return 0.5 * math.erfc(x * _HALF_ROOT)


@leaf_kernel
def _wrong_far(x: float, height: float) -> float:
    """Probability that a bit with margin x is wrong, its true level being no edge's; all in sigma.

    Where the noise reaches the contrast: from the odds of +height / 2 against -height / 2, the least margin
    that a bit of contrast `height` has away from its edges. Where the noise is small, a margin below that
    tells of something else, and nothing is known but the noise.
    """
    least = 0.5 * height
    return 1 / (1 + math.exp(min(2 * x * least, 100.0))) if x > least - 3 else _tail(x)


@leaf_kernel
def _beside(x: float, height: float, share: float, reach: float) -> tuple[float, float, float, float]:
    """Where the level may be an edge's, as likely as not anywhere between -height and height, as it is on a
    share of the pixels: probabilities that the bit is wrong, that it is and this is no edge, that this is an
    edge, and the mean square of the error there, cells^2; all else in sigma.

    On an edge that reaches `reach` cells to either side, the place is 1/2 - reach s / height cells from the
    middle of the cell that is read, s being the true level: the error is the same whichever cell is read.
    """
    flat, ramp = (1 - share) * _PEAK, share / height
    below, over, here = _tail(x), _tail(x + height), _tail(x - height)
    # densities at the margin of a flat level of the other sign and of the same
    low, high = math.exp(-0.5 * (x + height) ** 2), math.exp(-0.5 * (x - height) ** 2)
    on_edge = ramp * (here - over)
    total = flat * (low + high) + on_edge
    if total <= 0 or here <= over:
        return below, below, 0.0, 0.0
    # moments of s, normal around x, within the edge
    shift = _PEAK * (high - low) / (here - over)
    spread = 1 - _PEAK * ((height - x) * high + (height + x) * low) / (here - over) - shift * shift
    slope = reach / height
    error = (0.5 - slope * (x - shift)) ** 2 + slope * slope * max(spread, 0.0)
    return (flat * low + ramp * (below - over)) / total, flat * low / total, on_edge / total, error


@leaf_kernel
def misread(x: int, first: int, camera: Camera, code: CodeRecord, found: CellLines) -> None:
    """Sum over pixel x's bits of the probability that one is wrong, sorted by where the flipped bit would
    lead; mean square of the place's error.

    found.cell still holds words; set are far, up, down, place and clipped, at x.

    A bit that would lead far has its edge elsewhere, unless its edge is that of others, too (together), or
    it leads to the cell after the next but one: past the next one, should the finest bit be wrong besides.
    With fringes only that counts which leads away from the side on which the fringe lies: no edge is there.
    """
    frames, clip, plain, inverse, cells = camera.frames, camera.clip, code.plain, code.inverse, code.cells
    edges, together, word, half = code.edges, code.together, found.cell[x], found.half[x]
    (read2, gain), middle, far, up, down = camera.of_code, found.middle[x], found.far, found.up, found.down
    cell, beside, edged = cells[word], 0.0, together or not code.fringed
    on_edges, at_edges, off = 0.0, 0.0, 0.0
    noise, systematic = float(read2 + gain * middle), float(code.loose * half) ** 2
    unsure = max(systematic, float(edges.astray * half) ** 2)
    unsure = max(unsure, float(BRIGHTER * half) ** 2) if middle + half >= clip else unsure
    for far_ones in range(2):
        for bit in range(len(plain)):
            step = cells[word ^ (1 << bit)] - cell
            if (abs(step) != 1) != (far_ones == 1):
                continue
            if plain[bit] >= 0 and inverse[bit] >= 0:
                raw, other = frames[plain[bit], 0, first + x], frames[inverse[bit], 0, first + x]
                margin = 0.5 * (np.float32(raw) - np.float32(other))
                spread, lost = 0.5 * noise + systematic, raw >= clip and other >= clip
            else:
                raw = frames[max(plain[bit], inverse[bit]), 0, first + x]
                margin = np.float32(raw) - middle - edges.shift * half
                spread, lost = lone(code.source) * noise + unsure, raw >= clip and middle >= clip
            if lost:
                found.clipped[x] = 1
            sigma = math.sqrt(max(spread, _LEAST_SPREAD))
            seen, height = abs(float(margin)) / sigma, max(float(half) / sigma, _LOWEST)
            elsewhere = _wrong_far(seen, height * edges.contrast[bit])
            level, reach = height * edges.level[bit], edges.reach[bit]
            if abs(step) != 1:
                weight = 1.0 if together else beside if abs(step) == 3 and edged else 0.0
                if weight > 0:
                    elsewhere += weight * _beside(seen, level, edges.share[bit], reach)[0]
                far[x] += elsewhere
                continue
            wrong = elsewhere
            if edged:
                # this cell is beside the edge
                wrong, cell_off, on_edge, error = _beside(seen, level, reach, reach)
                on_edges += on_edge
                at_edges += on_edge * error
                off += cell_off
            if step == 1:
                up[x] += wrong
            else:
                down[x] += wrong
        beside = min(float(up[x] + down[x]), 1.0)
    found.place[x] = at_edges / max(on_edges, 1.0) + max(1 - on_edges, 0.0) * edges.inside + off
