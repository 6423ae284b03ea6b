"""Whether a frame's heights may be used, and the reason where they may not."""

from dataclasses import dataclass

from optolever.notices import Notice

from .reading import Figures

__all__ = ["Verdict", "judge"]

_LIGHT = (0.7, 1.4)  # of that at rest
_SATURATED = 0.01  # of the lit pixels
_CONTRAST = 0.85  # of that at rest, median of the good cells
_LOST = (0.01, 0.3)  # of the lit cells: limits of a notice and of a rejection
_LEFT = (1.0, 5.0)  # sigma
_CURL = (4.0, 20.0)  # of 1 by noise
_ANCHORED = 0.1  # of the anchor's cells
_MOVED = 0.25  # pixels


@dataclass(frozen=True, slots=True)
class Verdict:
    """trusted, reason: see Reading; notices: of deviations from rest."""

    trusted: bool
    reason: str
    notices: tuple[Notice, ...]


def judge(figures: Figures) -> Verdict:
    """The verdict, from the figures of a frame alone."""
    curl, light = max(figures.curl), figures.light
    stopped = [
        (1 - figures.lost, 1 - _LOST[1], "too few cells see a fringe"),
        (figures.anchored, _ANCHORED, "the mirror's edge at rest is not seen"),
        (-curl, -_CURL[1], "the slopes contradict one another, as in a torn or rolled frame"),
        (-figures.left, -_LEFT[1], "the fit does not settle"),
        (-figures.moved, -_MOVED, "the picture of the mirror's edge has moved: camera, display or mirror"),
    ]
    reasons = [text for value, least, text in stopped if not value >= least]
    told = [
        (figures.saturated, _SATURATED, "share of saturated pixels", "shorten the exposure"),
        (figures.lost, _LOST[0], "share of cells without height", "look for covers, folds and steep edges"),
        (figures.left, _LEFT[0], "sigma that the height may still change by", "sigma holds it"),
        (curl, _CURL[0], "circulation of the slopes over its noise", "sigma holds it; prepare the rig anew"),
        (1 - figures.contrast, 1 - _CONTRAST, "lost contrast", "the height is the mean over the exposure"),
        (light, _LIGHT[1], "light over that at rest", "prepare the rig anew in this light"),
        (1 / max(light, 1e-3), 1 / _LIGHT[0], "light at rest over the light now", "prepare the rig anew"),
    ]
    notices = tuple(Notice(name, size, limit, cure) for size, limit, name, cure in told if not size <= limit)
    return Verdict(not reasons, "; ".join(reasons), notices)
