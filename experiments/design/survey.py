"""Whether the decoder can tell the blur by contrasts, and how well."""

import math

import numpy as np

from optolever.patterns import Sequence

from .fringes import Fringe, contrast, grouped
from .view import Levels, View

__all__ = ["blur_told"]

#: Contrast (its logarithm) that blur must take from the finest fringe, for the decoder to tell it.
BLUR_TOLD = 0.009
#: Rows and columns of the camera that it measures blur by, and the share of them that it uses.
SURVEYED, SURVEYED_SHARE = (24, 192), 0.8


def blur_told(view: View, sequence: Sequence, levels: Levels, axis: str) -> float | None:
    """Noise of the squared blur (cells^2) that the decoder measures, None where it does not: white and black
    are shown, or contrasts likely differ enough, along this axis or else the other."""
    referenced, blur = (
        {"white", "black"} <= {frame.kind for frame in sequence.frames},
        view.scene.pattern.blur_px,
    )
    for name in (axis, "v" if axis == "u" else "u"):
        groups = grouped([f for f in sequence.frames if f.axis == name and f.kind == "phase"])
        if not groups:
            continue
        lever, uncertain = _blur_survey(view, name, groups, levels, referenced)
        if referenced or (len(groups) > 1 and lever * blur**2 > BLUR_TOLD):
            return uncertain / lever
    return None


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
    full = [round(n * view.stride) for n in seen.shape]
    count = max(1.0, SURVEYED_SHARE * seen.mean() * math.prod(map(min, full, SURVEYED)))
    return lever, math.sqrt(noise2 / count)
