"""Whether a frame's heights may be used, and the reason where they may not."""

import math
from dataclasses import dataclass

from optolever.notices import Notice

from .reading import CREPT, Figures

__all__ = ["FADED", "UNEXPLAINED", "Verdict", "judge"]

_LIGHT = (0.7, 1.4)  # of that at rest
_SATURATED = 0.01  # of the lit pixels
FADED = 0.85  # contrast over that at rest, median of the good cells
_MOVING = 20  # frames: a motion's blur ends before, a loss of focus stays
_LOST = (0.01, 0.3)  # of the lit cells: limits of a notice and of a rejection
_DUST = 0.001  # of the lit cells
_LEFT = (1.0, 5.0)  # sigma
_CURL = (4.0, 20.0)  # of 1 by noise
_ANCHORED = 0.1  # of the anchor's cells
_MOVED, _ROLLED = 0.5, math.radians(0.1)  # pixels; rad
UNEXPLAINED = 3.0  # noises: of the displacement outside the contacts


@dataclass(frozen=True, slots=True)
class Verdict:
    """trusted, reason: see Reading; notices: of deviations from rest; broken: it is not trusted, and not only
    since the rig has moved."""

    trusted: bool
    reason: str
    notices: tuple[Notice, ...]
    broken: bool


def judge(
    figures: Figures, faded: int = 0, steep: bool = False, dust: float = 0.0, strays: float = 0.0
) -> Verdict:
    """The verdict, from the figures of a frame; faded: how many frames up to this one had less
    contrast; steep: a flank rises to cells without a height, and is no contact; dust: share of the lit cells
    in holes to which none rises; strays: share of the lit pixels that the fit leaves out."""
    curl, light = max(figures.curl), figures.light
    stopped = [
        (1 - figures.lost, 1 - _LOST[1], "too few cells see a fringe: something covers it, or it is dark"),
        (figures.anchored, _ANCHORED, "the edge of the mirror, which is taken as at rest, is not visible"),
        (-curl, -_CURL[1], "the slopes contradict each other, as in a torn frame"),
        (-figures.left, -_LEFT[1], "the fit does not converge"),
    ]
    reasons = [text for value, least, text in stopped if not value >= least]
    if steep:
        reasons.append("a dent is too steep: no fringe is visible in its middle")
    broken, roll = bool(reasons), abs(figures.roll)
    if not broken and figures.moved > max(_MOVED, CREPT * figures.shift_sigma):
        reasons.append("the picture has moved as a whole (camera, display or mirror): tare")
    if not broken and roll > max(_ROLLED, CREPT * figures.roll_sigma):
        reasons.append(f"the camera has rolled by {math.degrees(roll):.2g} degrees: tare")
    held, others = "sigma includes it", "the other heights are not affected"
    anew, focused = "measure the mirror at rest anew in this light", faded <= _MOVING
    blur = "The mirror moved during the exposure" if focused else "Every frame is out of focus"
    mean = "heights are means over the exposure; shorten it"
    cure = mean if focused else "focus, and measure the mirror at rest anew"
    if light > 1 / FADED or light * figures.contrast > FADED:  # no blur adds light
        blur, cure = "More light than at rest, which is not the pattern's", f"darken the room, or {anew}"
    sinking, tilt = 1e3 * abs(figures.sinking), 1e6 * abs(figures.tilt)
    tare = "tare while nothing touches, and let the rig warm up"
    crept = f"as of a mirror that sank by {sinking:.2g} µm or tilted by {tilt:.2g} µrad; heights count it as "
    crept += f"the camera's motion, total_sigma as the mirror's; {tare}"
    thin = "sigma includes it; give [layer] thickness_mm if the silicone is thin; if the rig moved: tare"
    load = "Outside the contacts the mirror does not sink as under a load; residual over noise"
    still, level = CREPT * figures.shift_sigma, CREPT * math.degrees(figures.roll_sigma)
    rolled = f"heights are corrected; {tare}"
    change = "The fit has not converged; predicted change of the height, sigma"
    bounds = [
        (figures.moved, still, "The picture has moved as a whole since rest, pixels", crept),
        (math.degrees(roll), level, "The camera has rolled since rest, degrees", rolled),
        (figures.misfit, UNEXPLAINED, load, thin),
        (figures.saturated, _SATURATED, "Saturated pixels, share", "shorten the exposure"),
        (figures.lost - dust, _LOST[0], "Cells without a height (covered or too steep), share", others),
        (max(dust, strays), _DUST, "Dust or a hair: share of the picture without a fringe", "clean it"),
        (figures.left, _LEFT[0], change, held),
        (curl, _CURL[0], "The slopes contradict each other; mean square circulation over noise", held),
        (1 - figures.contrast, 1 - FADED, f"{blur}; loss of contrast", cure),
        (light, _LIGHT[1], "More light than at rest, ratio", anew),
        (1 / max(light, 1e-3), 1 / _LIGHT[0], "Less light than at rest, ratio at rest to now", anew),
    ]
    notices = tuple(
        Notice(name, size, limit, cure) for size, limit, name, cure in bounds if not size <= limit
    )
    return Verdict(not reasons, "; ".join(reasons), notices, broken)
