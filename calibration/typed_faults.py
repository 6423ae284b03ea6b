"""Typed numbers of a rig that contradict what its camera sees, each as a sentence."""

import math

import numpy as np

from optolever.arrays import Floats
from optolever.decode import Correspondence
from optolever.scene import Scene, dent, strided, trace

__all__ = ["aim_fault", "rest_fault"]


_SHARE = 1.5  # of the shares of the picture, measured and by the numbers
_TIMES = 1.3  # of the sizes on the display: beyond what a tape and 60 degrees leave
_ASIDE = 0.3  # of the display: an aim by hand
_COARSE = 64  # rows and columns that are compared


def aim_fault(seen: float, by_numbers: float) -> str:
    """A sentence where the share of the picture that sees the display contradicts the typed numbers; empty
    where they agree."""
    if by_numbers / _SHARE - 0.05 <= seen <= by_numbers * _SHARE + 0.05:
        return ""
    more = "more" if seen > by_numbers else "less"
    return (
        f"The reflection fills {100 * seen:.0f} % of the picture, by the typed numbers "
        f"{100 * by_numbers:.0f} %: {more} than it can. Check the mirror's size, the width of the view and "
        "its distance, and the distances."
    )


def rest_fault(found: Correspondence, scene: Scene) -> str:
    """What is wrong with the numbers, or the set-up, by the places on the display that the camera sees in the
    flat mirror: their turn, their size and their middle; empty: nothing."""
    step = max(1, max(found.u.shape) // _COARSE)
    few = strided(scene, step)
    flat = trace(few, dent("flat", few))
    seen = np.asarray(np.stack([found.u[::step, ::step], found.v[::step, ::step]]), np.float64)
    typed = np.asarray(np.stack([flat.u, flat.v]), np.float64)
    both = found.good[::step, ::step] & np.isfinite(typed).all(axis=0)
    if np.count_nonzero(both) < 12:
        return (
            "The camera sees nothing of the display where the mirror should be by the typed numbers: check "
            "the angles, the distances and the mirror's size, and the aim."
        )
    matrix, middle = _affine(typed[:, both], seen[:, both])
    away = middle - typed[:, both].mean(axis=1)
    area = float(np.linalg.det(matrix))
    if area < 0:
        return (
            "The picture is mirrored: switch off the camera's mirror image, and check that the display is "
            "neither rotated nor mirrored in its settings."
        )
    turn = math.degrees(math.atan2(matrix[1, 0] - matrix[0, 1], matrix[0, 0] + matrix[1, 1]))
    if abs(turn) > 135:
        return "The camera, or the display, is upside down: turn one of them by 180 degrees, and aim again."
    if abs(turn) > 45:
        return (
            f"The camera, or the display, is turned by {abs(turn):.0f} degrees: the camera's rows run along "
            "the mirror's width (y), as do a monitor's; turn one of them, and aim again."
        )
    size = math.sqrt(area)
    if not 1 / _TIMES < size < _TIMES:
        return (
            f"The camera sees {size:.2g} times as much of the display as the numbers say: check the width of "
            "the view and its distance, the display's diagonal, and the distances."
        )
    extent = np.array([scene.pattern.cols, scene.pattern.rows])
    if (np.abs(away) > _ASIDE * extent).any():
        millimetres = scene.pattern.pitch * math.hypot(*away)
        return (
            f"The camera sees a place of the display {millimetres:.0f} mm from where it is by the numbers: "
            "check the angles and the distances, and that the camera points at the mirror's middle."
        )
    return ""


def _affine(typed: Floats, seen: Floats) -> tuple[Floats, Floats]:
    """The matrix (2, 2) from places by the numbers to measured ones, and the middle of these (2,); the
    second fit goes without the tenth that is furthest off."""
    use = np.ones(typed.shape[1], np.bool_)
    for _ in range(2):
        columns = np.vstack([typed - typed[:, use].mean(axis=1, keepdims=True), np.ones(typed.shape[1])])
        found = np.linalg.lstsq(columns[:, use].T, seen[:, use].T, rcond=None)[0].T
        off = np.linalg.norm(seen - found @ columns, axis=0)
        use = off <= np.quantile(off, 0.9)
    return np.asarray(found[:, :2]), np.asarray(seen.mean(axis=1))
