"""Consequences of a wrong frame: frames that a code can omit, pixels that a wrong frame may affect."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter

from ..correspondence import Correspondence, Flag
from ..frames import Light
from ..plan import AxisPlan, Plan
from ..profile.noise import Noise
from .sample_fit import AxisTable, axis_tables, misfit_at

__all__ = ["Finding", "left_out", "spoilt_pixels"]

Mask = NDArray[np.bool_]
#: Fewest steps of a fringe after one is dropped: three give a phase, four test it.
_STEPS = 4
#: Flags of pixels that contradict themselves, or their neighbours.
_DOUBTFUL = Flag.ORDER_DOUBTFUL | Flag.OUTLIER | Flag.MOVED
#: Misfit of a strange pixel (see integrity), in units of the median, and its least value; side of the square
#: in which doubtful pixels outvote a good one, and their least ratio to good ones.
_STRANGE, _MISFIT, _AROUND, _OUTVOTED = 4.0, 0.2, 9, 1.0
#: Deviations, and share of the amplitude, by which a level may differ from its prediction.
_SIGMAS, _UNLIKE = 4.0, 0.2


@dataclass(frozen=True, slots=True)
class Finding:
    """A fault: numbers of the frames, kind, and a sentence; `spoilt` frames are wrong in rows start..stop
    (None: all).

    kind: swapped | lost | repeated | replaced (by another frame) | torn | contradicting (most pixels do) | in
    part (some pixels) | rolling (every frame, from a row on).
    confidence: 1 - probability of chance; share: of the illuminated pixels that it repairs; leave_out: frames
    to omit in decoding; images: image of each frame (-1: none; empty: unchanged).
    """

    frames: tuple[int, ...]
    kind: str
    sentence: str
    spoilt: tuple[int, ...] = ()
    rows: tuple[int, int] | None = None
    confidence: float = 1.0
    share: float = 0.0
    leave_out: tuple[int, ...] = ()
    images: tuple[int, ...] = ()

    @property
    def put_back(self) -> bool:
        """Whether two swapped frames, which the code cannot omit, are exchanged before decoding."""
        return self.kind == "swapped" and not self.leave_out and min(self.images, default=-1) >= 0

    @property
    def cure(self) -> str:
        """Remedy."""
        put_back = "put back; " if self.put_back else ""
        left = "decoded without; " if self.leave_out else put_back
        again = "capture again, or describe the frames as they were shown (--no-check: decode as described)"
        return left + again


def left_out(finding: Finding, plan: Plan) -> tuple[int, ...]:
    """Frames to omit in decoding, including those with unknown images; empty: impossible, or none."""
    if finding.kind in ("contradicting", "rolling"):
        return ()
    lost = {i for i, image in enumerate(finding.images) if image < 0}
    wrong, ends = lost or set(finding.spoilt), {plan.white, plan.black}
    found = [_droppable(axis, wrong, ends) for axis in plan.axes]
    if None in found:
        return ()
    return tuple(sorted((wrong & ends).union(*(one or set() for one in found))))


def _droppable(axis: AxisPlan, wrong: set[int], ends: set[int]) -> set[int] | None:
    """Frames of an axis to drop: bits with a valid inverse and white and black, steps of five or more,
    complete periods; None: the axis needs the wrong frames."""
    out, own = set[int](), wrong & set(axis.frames())
    code = axis.code
    pairs = [] if code is None else list(zip(code.plain.tolist(), code.inverse.tolist(), strict=True))
    paired = all(min(pair) >= 0 and not wrong & set(pair) for pair in pairs)
    if not paired and wrong & ends:
        return None  # bits need white and black as references
    for pair in pairs:
        bad = wrong & set(pair)
        if bad and (len(bad) > 1 or min(*pair, *ends) < 0):
            return None
        out |= bad
    for fringe in axis.fringes:
        bad = wrong & set(fringe.index)
        if bad:
            out |= bad if len(fringe.index) - len(bad) >= _STEPS else set(fringe.index)
    left = [fringe for fringe in axis.fringes if not out >= set(fringe.index)]
    whole = code is not None or any(fringe.period >= axis.extent for fringe in left)
    if not own <= out or (len(left) < len(axis.fringes) and (axis.looked_up or not whole)):
        return None
    return out


def spoilt_pixels(finding: Finding, light: Light, plan: Plan, noise: Noise, found: Correspondence) -> Mask:
    """Pixels (H, W) that wrong frames may affect.

    These are: pixels where the level of a wrong frame differs from the prediction at the decoded place;
    pixels where swapped frames differ; all pixels, if a wrong bit has no valid inverse, or later frames are
    displaced.
    """
    shape = light.raw.shape[1:]
    rows = slice(*finding.rows) if finding.rows else slice(None)
    spoilt = np.zeros(shape, np.bool_)
    if finding.kind in ("lost", "repeated", "contradicting", "rolling"):
        spoilt[rows] = True
        return spoilt
    if finding.kind == "in part":
        return _strange(light, plan, found)
    if finding.kind == "swapped":
        levels = light.linear(light.raw[list(finding.spoilt)])
        return np.asarray(np.ptp(levels, axis=0) > _SIGMAS * np.sqrt(2 * noise.variance(levels[0])))
    tables = axis_tables(plan)
    for frame in finding.spoilt:
        for table in tables:
            if frame in table.frames:
                spoilt[rows] |= _contradicted(frame, finding, light, table, noise, found)[rows]
    return spoilt


def _strange(light: Light, plan: Plan, found: Correspondence) -> Mask:
    """Good pixels (H, W) whose levels contradict their place, and good ones amid doubtful ones, which agree
    by chance."""
    at = np.nonzero(found.flags == 0)
    strange = np.zeros(found.flags.shape, np.bool_)
    if not at[0].size:
        return strange
    for table in axis_tables(plan):
        levels = light.linear(light.raw[table.frames[:, None], *at]) / table.exposure[:, None]
        misfit = misfit_at(table, levels, getattr(found, table.axis.axis)[at])
        strange[at] |= ~(misfit < _STRANGE * max(float(np.nanmedian(misfit)), _MISFIT))
    doubtful = strange | (found.flags & np.uint16(_DOUBTFUL) > 0)
    good = (found.flags == 0) & ~strange
    around = [uniform_filter(one.astype(np.float32), _AROUND) for one in (doubtful, good)]
    return np.asarray(strange | (good & (around[0] > _OUTVOTED * around[1])))


def _contradicted(
    frame: int, finding: Finding, light: Light, table: AxisTable, noise: Noise, found: Correspondence
) -> Mask:
    """Pixels (H, W) whose place along an axis a wrong frame may have changed."""
    level = light.linear(light.raw[frame])
    code = table.axis.code
    if code is not None and frame in (*code.plain, *code.inverse):
        polarity, other = (code.plain, code.inverse) if frame in code.plain else (code.inverse, code.plain)
        partner = int(other[np.flatnonzero(polarity == frame)[0]])
        if partner < 0 or partner in finding.spoilt:
            return np.ones(level.shape, np.bool_)
    if found.amplitude is None or found.offset is None:
        return np.ones(level.shape, np.bool_)
    slot = int(np.flatnonzero(table.frames == frame)[0])
    shown = table.shown[slot][table.entry(getattr(found, table.axis.axis))]
    apart = np.abs(level / table.exposure[slot] - found.offset - found.amplitude * shown)
    limit2 = _SIGMAS**2 * noise.variance(level) + (_UNLIKE * found.amplitude) ** 2
    return np.asarray(~(apart**2 <= limit2))
