"""Why few pixels of a capture are good: one sentence. How much of the image the mirror fills."""

import math
from typing import Any

import cv2
import numpy as np
import scipy
from numpy.typing import NDArray

from optolever.kernels import F64
from optolever.notices import Notice
from optolever.patterns import Sequence

from ..correspondence import Correspondence, Flag
from ..frames import Light
from ..noise import quantile
from ..plan import plan

__all__ = ["few_good", "mirror_coverage"]

#: Good share of the lit pixels below which a sentence says why, share off the pattern above which one does.
_FEW, _OFF = 0.5, 1 / 6
#: Pixels that are looked at: each so many-th of a row and of a column.
_SEEN = 1 << 13
#: Amplitude of the modulation over white from which on contrast is no cause, and the cure then (_OTHERWISE).
_AMPLE = 0.1
#: Range of a pixel's levels over white from which on light is no cause, and the cure then.
_BRIGHT, _FOCUS = 0.3, "focus the camera on the mirror with a smaller aperture, or show longer periods"
_OTHERWISE = (
    "contrast is high, so most likely fringe orders are ambiguous (show a period as long as the pattern, "
    "or Gray bits), the display has gamma or lag, or capture.toml states other periods, steps or pixels"
)
_EXPOSE = "switch off the camera's automatic exposure and gain"
#: Notices that are no cause: each costs sigma alone.
_SIGMA = "sigma is"
_NOTHING = Notice.plain(
    "no pixel fits the sequence", "correct the order of the frames, or their description in capture.toml"
)


def few_good(found: Correspondence, light: Light, sequence: Sequence) -> tuple[Notice | None, bool]:
    """A notice where less than half of the lit pixels are good, or a sixth lies off the pattern; whether it
    is certain, else another notice may know better."""
    assert found.amplitude is not None
    some = (slice(None, None, max(1, math.isqrt(found.flags.size // _SEEN))),) * 2
    flags, amplitude = found.flags[some], found.amplitude[some]
    inside = flags & Flag.INVALID == 0
    if not inside.all():  # a pixel by itself has no neighbours that could confirm it: no fault of the capture
        known = (found.flags & Flag.INVALID == 0).astype(np.float32)
        inside &= scipy.ndimage.uniform_filter(known, 3, mode="nearest")[some] > 0.5
    bright = amplitude[inside & (amplitude > 0)]
    if not len(bright):
        return (_NOTHING if (found.flags & Flag.INVALID).all() and not found.notices else None), False
    lit = inside & (amplitude > 0.5 * quantile(bright, 0.95))
    flags = flags[lit]
    good = np.count_nonzero(flags == 0) / len(flags)

    def share(flag: Flag) -> float:
        return np.count_nonzero(flags & flag) / len(flags)

    if good >= _FEW and share(Flag.OFF_PATTERN) < _OFF:
        return None, False
    levels = light.raw[(slice(None), *some)][:, lit]
    means = light.raw[(slice(None), *some)].mean(axis=(1, 2))
    if good < _FEW and (exposed := _exposed_by_itself(means, amplitude[lit], sequence)):
        return Notice.plain(f"{good:.0%} of the lit pixels are good: {exposed}", _EXPOSE), True
    places = {axis: getattr(found, axis)[some][lit].astype(np.float64) for axis in ("u", "v")}
    ample = float(np.median(amplitude[lit])) > _AMPLE * light.clip
    name, cure, certain = _cause(levels, light.clip, ample, places, sequence, share)
    if not certain and any(not one.name.startswith(_SIGMA) for one in found.notices):
        return None, False
    return Notice.plain(f"{good:.0%} of the lit pixels are good: {name}", cure), certain


def _exposed_by_itself(means: NDArray[Any], amplitude: NDArray[Any], sequence: Sequence) -> str:
    """Says that white is no brighter than other frames although fringes swing; else nothing. means (N,) of
    frames, amplitude (K,) of fringes."""
    known = plan(sequence)
    if min(known.white, known.black) < 0 or not any(axis.fringes for axis in known.axes):
        return ""
    fringes, usual = 2 * float(np.median(amplitude)), float(np.median(means))
    if float(means.max()) - usual > 0.25 * fringes:
        return ""
    return f"all frames have {usual:.0f} levels on average, white too, though fringes span {fringes:.0f}"


def _off_the_end(axis: str, extent: int, places: NDArray[Any]) -> str:
    """Where the places (K,) of an axis leave the pattern."""
    low, high = np.quantile(places, (0.01, 0.99))
    if -low > high - (extent - 1):
        return f"{axis} begins at {low:,.0f} of 0 to {extent - 1:,}: offset_px, or u and v exchanged?"
    return f"{axis} ends at {high:,.0f} of {extent:,}: offset_px, or u and v exchanged?"


def _cause(
    levels: NDArray[Any], clip: float, ample: bool, found: dict[str, F64], sequence: Sequence, share: Any
) -> tuple[str, str, bool]:
    """The cause, its cure and whether it is certain, of levels (N, K) and places (K,); ample: contrast; the
    most certain one first."""
    some = levels[:, :: 1 + levels.shape[1] // 4096]
    if any(axis.fringes for axis in plan(sequence).axes) and len(np.unique(some)) < 3:
        cure = "fringes need grey values: capture without a threshold"
        return "the frames hold two levels only", cure, True
    clipped = (some >= clip).mean(axis=1)
    coded = np.array([frame.axis is not None for frame in sequence.frames])
    if np.mean(clipped[coded] > 0.25) > 0.5 or share(Flag.SATURATED) > 0.5:
        return f"{np.count_nonzero(clipped > 0.25)} of {len(some)} frames clip", "expose less", True
    if share(Flag.OFF_PATTERN) >= _OFF:
        for axis in plan(sequence).axes:
            places = found[axis.axis]
            beyond = (places < -0.5) | (places > axis.extent - 0.5)
            if beyond.mean() > 0.5 * _OFF:
                return _off_the_end(axis.axis, axis.extent, places), "correct capture.toml", False
    if share(Flag.DARK | Flag.LOW_CONTRAST) > 0.5 and not ample:
        swing = float(np.ptp(some, axis=0).mean())
        if swing > _BRIGHT * clip:
            return f"fringes are weak where frames differ by {swing:.0f} levels", _FOCUS, True
        cure = "expose longer, or show more steps (gray+phase:steps=16)"
        return f"the pattern is too weak for its sequence, {swing:.2g} levels", cure, True
    cure = _OTHERWISE if ample else "most likely too little contrast: expose longer"
    dust = "most likely dust or a rough mirror: clean it, or show longer periods"
    causes = {
        Flag.ORDER_DOUBTFUL: ("fringe orders are ambiguous", cure),
        Flag.OUTLIER: ("neighbouring pixels contradict each other", dust),
        Flag.WRONG_FRAME: ("frames contradict each other", "capture again, or correct capture.toml"),
        Flag.OFF_PATTERN: ("the others lie beyond the pattern", "correct decode --pixels, or capture.toml"),
        Flag.SATURATED: ("samples clip", "expose less"),
    }
    worst = max(causes, key=share)
    return *causes[worst], worst is Flag.SATURATED


def mirror_coverage(flags: NDArray[np.unsignedinteger[Any]]) -> tuple[float, float]:
    """Share of the image (H, W) that the mirror fills, and good share of the mirror (NaN without one).

    The mirror: pixels whose level changes with the patterns, with holes filled, except masked pixels.
    """
    without = Flag.DARK | Flag.LOW_CONTRAST | Flag.INVALID
    changing = (flags & without == 0) | (flags & Flag.SATURATED != 0)
    around = np.pad(changing.astype(np.uint8), 1)
    cv2.floodFill(around, None, (0, 0), 2)
    mirror = (around[1:-1, 1:-1] != 2) & (flags & Flag.INVALID == 0)
    good = float((flags == 0)[mirror].mean()) if mirror.any() else math.nan
    return float(mirror.mean()), good
