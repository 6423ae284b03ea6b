"""Whether the decoder can tell the blur by contrasts or their swing, and how well."""

import math

import numpy as np

from optolever.decode import Contrasts, blur_by_swing, seems_to_swing
from optolever.patterns import Sequence

from .cells import seen_sidebands
from .fringes import Fringe, contrast, grouped
from .response import fundamental_share
from .view import Levels, View

__all__ = ["blur_told"]

#: Systematic error of a contrast (its logarithm) that the decoder reckons with; errors of it that blur must
#: take from the finest fringe, for the decoder to tell it.
UNSURE, TOLD = 0.003, 3.0
#: Rows and columns of the camera that it measures blur by, and the share of them that it uses.
SURVEYED, SURVEYED_SHARE = (16, 144), 0.8
#: Distance from the middle up to which it looks at the swing, as a share of the pattern.
SURVEYED_INNER = 0.4
#: One of so many pixels is asked first whether a contrast swings; draws of noise in which it is told or not.
LOOKED_AT, DRAWS = 4, 9


def blur_told(view: View, sequence: Sequence, levels: Levels, axis: str) -> float | None:
    """Noise of the squared blur (cells^2) that the decoder measures, None where it does not: white and black
    are shown, contrasts likely differ enough, or they swing enough with the cells, along this axis or else
    the other."""
    referenced = {"white", "black"} <= {frame.kind for frame in sequence.frames}
    blur, swinging = view.scene.pattern.blur_px, []
    for name in (axis, "v" if axis == "u" else "u"):
        groups = grouped([f for f in sequence.frames if f.axis == name and f.kind == "phase"])
        if not groups:
            continue
        lever, uncertain = _blur_survey(view, name, groups, levels, referenced)
        if referenced or (len(groups) > 1 and lever * blur**2 > TOLD * math.hypot(UNSURE, uncertain)):
            return uncertain / lever
        swinging.append(_swung(view, name, groups[-1], levels))
    # in every draw whichever axis tells it
    told = [next((one for one in draw if one is not None), None) for draw in zip(*swinging, strict=True)]
    known = [one for one in told if one is not None]
    return float(np.median(known)) if 2 * len(known) > len(told) else None


def _swung(view: View, axis: str, group: Fringe, levels: Levels) -> tuple[float | None, ...]:
    """The same by the swing of a contrast: as the decoder itself tells it, in draws of noise."""

    def drawn() -> tuple[float | None, ...]:
        return tuple(_by_swing(view, axis, group, levels, seed) for seed in range(DRAWS))

    key = ("swung", axis, group.period, len(group.shifts), levels.read2, levels.shot)
    return view.kept(key, drawn)


def _by_swing(view: View, axis: str, group: Fringe, levels: Levels, seed: int) -> float | None:
    """In one draw."""
    coord, extent, blur = view.coordinate(axis), view.extent(axis), view.scene.pattern.blur_px
    there = view.visible & (view.light > 0) & (np.abs(coord - 0.5 * (extent - 1)) < SURVEYED_INNER * extent)
    rng = np.random.default_rng(seed)
    count = round(SURVEYED_SHARE * there.mean() * _surveyed(view))
    row, col = np.unravel_index(np.sort(rng.permutation(np.flatnonzero(there))[:count]), coord.shape)
    width = view.widths[axis][0][row, col], view.widths[axis][1][row, col]
    half = levels.half[row, col]
    amplitude = fundamental_share(view.scene) * half * contrast(group.period, width, blur)
    variance, steps = levels.variance(half), len(group.shifts)
    deviation = np.sqrt(variance * (2 / amplitude**2 + 1 / half**2) / steps)
    shown = contrast(group.period, width, 0.0) * np.abs(seen_sidebands(view, axis, group.period)[row, col])
    seen = shown * (1 + deviation * rng.standard_normal(len(row)))
    at = 2 * np.stack([row, col]) / np.array(coord.shape)[:, None] - 1
    place, sides = coord[row, col], np.stack(width)
    few = slice(None, None, LOOKED_AT)
    looked_at = Contrasts(seen[few], place[few], sides[:, few], at[:, few])
    if not seems_to_swing(looked_at, group.period):
        return None
    told = blur_by_swing(Contrasts(seen, place, sides, at), group.period)
    return None if told is None else told.square_error


def _surveyed(view: View) -> int:
    """Pixels on the rows and columns that the decoder looks at."""
    return math.prod(
        min(round(n * view.stride), m) for n, m in zip(view.visible.shape, SURVEYED, strict=True)
    )


def _blur_survey(
    view: View, axis: str, groups: list[Fringe], levels: Levels, referenced: bool
) -> tuple[float, float]:
    """What measuring the blur by contrasts goes by: the logarithm of the contrast per squared blur (1 /
    cells^2), and its noise over the pixels surveyed."""
    blur, seen = view.scene.pattern.blur_px, view.visible
    widths = tuple(float(np.median(width[seen])) for width in view.widths[axis])
    half = float(np.median(levels.half[seen]))
    deviation = math.sqrt(float(levels.variance(half)))
    used = [groups[-1]] if referenced else [groups[-1], groups[0]]
    noise2, lever = (0.5 * (deviation / half) ** 2 if referenced else 0.0), 0.0
    for sign, group in zip((1, -1), used, strict=False):
        boxes = np.array(widths[0]), np.array(widths[1])
        amplitude = half * float(contrast(group.period, boxes, blur))
        noise2 += 2 / len(group.shifts) * (deviation / amplitude) ** 2
        lever += sign * 2 * (math.pi / group.period) ** 2
    count = max(1.0, SURVEYED_SHARE * seen.mean() * _surveyed(view))
    return lever, math.sqrt(noise2 / count)
