"""packed(): a sequence in a third of the exposures, each channel of a display with frames of its own."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace

import numpy as np

from optolever.errors import InputError

from .channels import Packing
from .codes import BINARY_CODES
from .frame import Frame
from .sequence import Sequence

__all__ = ["packed"]

#: First channel of fringes along u and v, and of everything else.
_FIRST = {"u": 0, "v": 2, "": 1}
#: Levels of a ramp between black and white, to which the strides through them are prime.
_LEVELS = 8
#: Of the fringe that shows the display's stripes, cells.
_PERIOD = 16.0
_PACKED = ("phase", "white", "black", *BINARY_CODES)


def packed(sequence: Sequence, stripes: str = "none") -> Sequence:
    """The sequence with a packing of its frames, which are in the order of time, channel after channel.

    Fringes along u go to red, along v to blue, all else to green; then the coarsest groups move from the
    fullest channel to the emptiest while that makes fewer exposures. A whole fringe, a bit and its inverse,
    white and black stay in one channel, so that no gain of a channel comes between them. stripes: see
    Packing. The sequence `ramp` becomes 25 pictures that measure the mix and the curves of the channels, and
    their stripes. InputError for other frames; for bits alone along u with stripes, which move their edges;
    for fringes along u in several channels with stripes that are unknown.

    >>> from optolever.patterns import sequence
    >>> grey = sequence("phase", 480, 640, periods=(36, 32.7, 30))
    >>> len(grey), len(packed(grey).packing.exposures)
    (24, 8)
    """
    if all(frame.kind == "uniform" for frame in sequence.frames):
        return _ramp(sequence, stripes)
    for frame in sequence.frames:
        if frame.kind not in _PACKED:
            known = ", ".join(_PACKED)
            raise InputError(f"packed: kind {frame.kind!r} is shown in grey alone, colour takes {known}")
    along_u = {frame.kind for frame in sequence.frames if frame.axis == "u"}
    if stripes != "none" and along_u and "phase" not in along_u:
        cure = "add fringes (gray+phase), or show grey"
        raise InputError(f"packed: bits alone along u cannot be drawn for stripes {stripes}; {cure}")
    channels: list[list[list[int]]] = [[], [], []]
    for channel, index in _groups(sequence):
        channels[channel].append(index)

    def size(channel: int) -> int:
        return sum(map(len, channels[channel]))

    for _ in sequence.frames:
        full, empty = max(range(3), key=size), min(range(3), key=size)
        fits = [group for group in channels[full] if size(empty) + len(group) < size(full)]
        if fits:
            channels[full].remove(fits[-1])
            channels[empty].append(fits[-1])
    if stripes == "unknown" and sum(_shows_fringe_of_u(sequence, groups) for groups in channels) > 1:
        cure = "state their order (rgb, bgr, none), take gray+phase, or show grey"
        raise InputError(f"packed: fringes along u in several colours need the display's stripes; {cure}")
    rows = [_woven(sequence, groups, channel == _FIRST[""]) for channel, groups in enumerate(channels)]
    most = max(rows, key=len)
    # an idle channel repeats its last frame, whose mean has less noise
    filled = np.array([row + row[-1:] * (len(most) - len(row)) if row else most for row in rows])
    frames, first = np.unique(filled.ravel(), return_index=True)
    in_time = frames[np.argsort(first)]
    number = np.empty_like(in_time)
    number[in_time] = np.arange(len(in_time))
    exposures = tuple((r, g, b) for r, g, b in number[filled].T.tolist())
    return replace(
        sequence,
        frames=tuple(sequence.frames[i] for i in in_time),
        packing=Packing(exposures, stripes),
    )


def _shows_fringe_of_u(sequence: Sequence, groups: list[list[int]]) -> bool:
    frames = (sequence.frames[i] for group in groups for i in group)
    return any((frame.kind, frame.axis) == ("phase", "u") for frame in frames)


def _ramp(sequence: Sequence, stripes: str) -> Sequence:
    """Black, red, green, blue, white; then eight levels twice in each channel, in three orders at once, so
    that no channel follows another; four steps of a fringe along u in all channels, for the stripes."""
    levels = sorted({frame.level or 0 for frame in sequence.frames})
    inner = [level for level in levels if 0 < level < 255]
    if levels[0] > 0 or levels[-1] < 255 or len(inner) < _LEVELS:
        raise InputError(f"packed: {len(levels)} levels, must be 0, 255 and {_LEVELS} or more between")
    chosen = [inner[k * (len(inner) - 1) // (_LEVELS - 1)] for k in range(_LEVELS)]
    last, order = _LEVELS + 1, range(_LEVELS)
    rows = [(0, 0, 0), (last, 0, 0), (0, last, 0), (0, 0, last), (last, last, last)]
    for turn in range(2):
        of = [[(k * (2 * c + 1) + c + 3 * turn * c) % _LEVELS + 1 for k in order] for c in range(3)]
        rows += [(r, g, b) for r, g, b in zip(*of, strict=True)]
    frames = [Frame("uniform", level=level) for level in (0, *chosen, 255)]
    for k in range(4):
        rows.append((len(frames), len(frames) + 1, len(frames) + 2))
        frames += 3 * [Frame("phase", axis="u", period_px=_PERIOD, shift=0.5 * k * np.pi)]
    return replace(sequence, frames=tuple(frames), packing=Packing(tuple(rows), stripes))


def _groups(sequence: Sequence) -> list[tuple[int, list[int]]]:
    """First channel, and frames that must share one, finest first. Single shifts go with the whole fringe of
    their axis, by whose amplitude they are read."""
    count = Counter((frame.axis, frame.period_px) for frame in sequence.frames if frame.kind == "phase")
    fine = {
        axis: min((p or 0 for (a, p), n in count.items() if a == axis and n > 2), default=0) for axis in "uv"
    }
    found: dict[tuple[int, float, int, str, str], list[int]] = {}
    for i, frame in enumerate(sequence.frames):
        axis = frame.axis or ""
        if frame.kind == "phase":
            whole = count[axis, frame.period_px] > 2
            period = (frame.period_px or 0.0) if whole else fine[axis]
            key = 0, float(period), _FIRST[axis], "", ""
        elif frame.bit is None:
            key = 1, 0.0, _FIRST[""], "", ""
        else:
            key = 2, float(frame.bit), _FIRST[""], frame.kind, axis
        found.setdefault(key, []).append(i)
    return [(key[2], found[key]) for key in sorted(found)]


def _woven(sequence: Sequence, groups: list[list[int]], back: bool) -> list[int]:
    """Frames of a channel in time. Frames of codes go between the shifts of an only fringe: a lag of a bit
    adds a level, no phase; one comes first, so that all shifts follow known frames. Without codes a fringe of
    odd steps, which cannot balance a lag, has the next fringe's shifts between its own."""
    parts = [_ordered(sequence, group, back) for group in groups]
    fringes = sum(sequence.frames[group[0]].kind == "phase" for group in groups)
    if not parts:
        return []
    first, others = parts[0], [i for part in parts[1:] for i in part]
    if fringes > 1 and len(first) % 2:
        others[: len(parts[1])] = parts[1][::-1]
    elif fringes != 1 or len(others) < len(first) - 1:
        return first + others
    between = (others + others[-1:])[: len(first)]
    mixed = [i for pair in zip(between, first, strict=True) for i in pair]
    return mixed + others[len(first) :]


def _ordered(sequence: Sequence, index: list[int], back: bool) -> list[int]:
    """Four shifts as 0, 1, 3, 2: the frame before is a step less as often as a step more, so that lag adds no
    phase. Green runs backwards: what leaks between fringes of one axis then beats with the sum of their
    frequencies, which no height accumulates."""
    frames = [sequence.frames[i] for i in index]
    if len(index) < 3 or frames[0].kind != "phase" or len({frame.period_px for frame in frames}) > 1:
        return index
    by = sorted(index, key=lambda i: sequence.frames[i].shift or 0.0)
    steps = (0, 1, 3, 2) if len(by) == 4 else range(len(by))
    return [by[-k % len(by) if back else k] for k in steps]
