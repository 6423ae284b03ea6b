"""Why few pixels of a capture are good: one sentence."""

from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from optolever.notices import Notice
from optolever.patterns import Sequence

from .frames import Light
from .plan import plan
from .records import Correspondence, Flag

__all__ = ["few_good", "off_the_end"]

#: Good share of the lit pixels below which a sentence says why, share off the pattern above which one does.
_FEW, _OFF = 0.5, 1 / 6
#: Pixels by which lit ones are known.
_SEEN = 1 << 15
#: Amplitude of the modulation over white from which on contrast is no cause, and the cure then.
_AMPLE = 0.1
_OTHERWISE = (
    "their contrast is high: either the periods repeat on the pattern (add one as wide as it, or bits), or "
    "periods, shifts, steps or the pattern's pixels are others than described"
)
#: Notices that are no cause: each costs sigma alone.
_SIGMA = "sigma is"


def few_good(found: Correspondence, light: Light, sequence: Sequence) -> tuple[Notice, ...]:
    """A notice where less than half of the lit pixels are good, or a sixth lies off the pattern, and no other
    notice names the cause."""
    assert found.amplitude is not None
    inside = found.flags & Flag.INVALID == 0
    if not inside.all():  # a pixel by itself has no neighbours that could confirm it: no fault of the capture
        inside &= scipy.ndimage.uniform_filter(inside.astype(np.float32), 3, mode="nearest") > 0.5
    bright = found.amplitude[inside & (found.amplitude > 0)]
    if not len(bright):
        return ()
    lit = inside & (found.amplitude > 0.5 * np.percentile(bright[:: 1 + len(bright) // _SEEN], 95))
    number = np.count_nonzero(lit)
    good = np.count_nonzero(lit & found.good) / number

    def share(flag: Flag) -> float:
        return np.count_nonzero(found.flags[lit] & flag) / number

    if good >= _FEW and share(Flag.OFF_PATTERN) < _OFF:
        return ()
    if any(not one.name.startswith(_SIGMA) for one in found.notices):
        return ()
    name, cure = _cause(found, light, sequence, lit, share)
    return (Notice(f"{good:.0%} of the lit pixels are good: {name}", float("nan"), float("nan"), cure),)


def off_the_end(axis: str, extent: int, places: NDArray[Any]) -> str:
    """Where the places (K,) of an axis leave the pattern."""
    low, high = np.quantile(places, (0.01, 0.99))
    if -low > high - (extent - 1):
        return f"{axis} begins at {low:,.0f} of 0 to {extent - 1:,}: offset_px, or u and v exchanged?"
    return f"{axis} ends at {high:,.0f} of {extent:,}: offset_px, or u and v exchanged?"


def _cause(
    found: Correspondence, light: Light, sequence: Sequence, lit: NDArray[np.bool_], share: Any
) -> tuple[str, str]:
    """The cause and its cure; the most certain one first."""
    amplitude = np.asarray(found.amplitude)[lit]
    some = light.raw[:, lit][:, :: 1 + int(lit.sum()) // 4096]
    if any(axis.fringes for axis in plan(sequence).axes) and len(np.unique(some)) < 3:
        return "the frames hold two levels only", "fringes need grey values: capture without a threshold"
    clipped = (some >= light.clip).mean(axis=1)
    coded = np.array([frame.axis is not None for frame in sequence.frames])
    if np.mean(clipped[coded] > 0.25) > 0.5 or share(Flag.SATURATED) > 0.5:
        return f"{np.count_nonzero(clipped > 0.25)} of {len(some)} frames clip", "expose less"
    if share(Flag.OFF_PATTERN) >= _OFF:
        for axis in plan(sequence).axes:
            places = np.asarray(getattr(found, axis.axis)[lit], np.float64)
            beyond = (places < -0.5) | (places > axis.extent - 0.5)
            if beyond.mean() > 0.5 * _OFF:
                return off_the_end(axis.axis, axis.extent, places), "correct capture.toml"
    ample = float(np.median(amplitude)) > _AMPLE * light.clip
    if share(Flag.DARK | Flag.LOW_CONTRAST) > 0.5 and not ample:
        cure = "expose longer, or show more steps (gray+phase:steps=16)"
        return f"the pattern is too weak for its sequence, {np.ptp(some, axis=0).mean():.2g} levels", cure
    causes = {
        Flag.ORDER_DOUBTFUL: (
            "fringe orders are ambiguous",
            _OTHERWISE if ample else "most likely too little contrast: expose longer",
        ),
        Flag.OUTLIER: (
            "neighbouring pixels contradict each other",
            "most likely dust or a rough mirror: clean it, or show longer periods",
        ),
        Flag.WRONG_FRAME: ("frames contradict each other", "capture again, or correct capture.toml"),
        Flag.OFF_PATTERN: ("the others lie beyond the pattern", "correct decode --pixels, or capture.toml"),
        Flag.SATURATED: ("samples clip", "expose less"),
    }
    return causes[max(causes, key=share)]
