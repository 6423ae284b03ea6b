"""Whether a frame's heights may be used, and the reason where they may not."""

from dataclasses import dataclass

from optolever.notices import Notice

from .reading import CREPT, Figures

__all__ = ["FADED", "Verdict", "judge"]

_LIGHT = (0.7, 1.4)  # of that at rest
_SATURATED = 0.01  # of the lit pixels
FADED = 0.85  # contrast over that at rest, median of the good cells
_MOVING = 20  # frames: a motion's blur ends before, a loss of focus stays
_LOST = (0.01, 0.3)  # of the lit cells: limits of a notice and of a rejection
_LEFT = (1.0, 5.0)  # sigma
_CURL = (4.0, 20.0)  # of 1 by noise
_ANCHORED = 0.1  # of the anchor's cells
_MOVED = 0.25  # pixels


@dataclass(frozen=True, slots=True)
class Verdict:
    """trusted, reason: see Reading; notices: of deviations from rest; broken: it is not trusted, and not only
    since the rig has moved."""

    trusted: bool
    reason: str
    notices: tuple[Notice, ...]
    broken: bool


def judge(figures: Figures, faded: int = 0, steep: bool = False) -> Verdict:
    """The verdict, from the figures of a frame; faded: how many frames up to this one had less
    contrast; steep: a flank rises to cells without a height, and is no contact."""
    curl, light = max(figures.curl), figures.light
    stopped = [
        (1 - figures.lost, 1 - _LOST[1], "too few cells see a fringe: cover, fold, or light lost"),
        (figures.anchored, _ANCHORED, "the edge of the mirror, which is taken as at rest, is not visible"),
        (-curl, -_CURL[1], "the slopes contradict each other, as in a torn or rolled frame"),
        (-figures.left, -_LEFT[1], "the fit does not converge"),
    ]
    reasons = [text for value, least, text in stopped if not value >= least]
    if steep:
        reasons.append("a dent is too steep: its middle has no height, and its flank none that is sure")
    broken = bool(reasons)
    if not broken and figures.crept and figures.moved > _MOVED + figures.pulled:  # else contacts may pull
        reasons.append("the image of the mirror's edge has moved (camera, display or mirror): tare")
    held, others = "sigma includes it", "heights of the other cells stand"
    anew, mean = "prepare the rig anew in this light", "the height is the mean over the exposure; shorten it"
    blur = "The mirror moved during the exposure; loss of contrast"
    if faded > _MOVING:
        blur, mean = (
            "Less contrast in every frame: focus or dust; loss",
            "clean, focus, prepare anew",
        )
    crept = "sigma includes it; tare while nothing touches, and let the rig warm up"
    bounds = [
        (
            figures.moved,
            CREPT * figures.shift_sigma + figures.pulled,
            "The rig has moved since it was at rest, pixels",
            crept,
        ),
        (figures.saturated, _SATURATED, "Saturated pixels, share", "shorten the exposure"),
        (figures.lost, _LOST[0], "Cells without a height (cover, fold or steep edge), share", others),
        (figures.left, _LEFT[0], "The fit has not converged; predicted change of the height, sigma", held),
        (curl, _CURL[0], "The slopes contradict each other; mean square circulation over noise", held),
        (1 - figures.contrast, 1 - FADED, blur, mean),
        (light, _LIGHT[1], "More light than at rest, ratio", anew),
        (1 / max(light, 1e-3), 1 / _LIGHT[0], "Less light than at rest, ratio at rest to now", anew),
    ]
    notices = tuple(
        Notice(name, size, limit, cure) for size, limit, name, cure in bounds if not size <= limit
    )
    return Verdict(not reasons, "; ".join(reasons), notices, broken)
