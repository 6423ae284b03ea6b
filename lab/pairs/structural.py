"""Structural faults: frames in another order than described, or other frames than described.

Every fault contradicts itself somewhere in the frames: what another scene would show as well is left out.
"""

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from optolever.experiments.ideal import Fault
from optolever.patterns import Frame, Sequence

Frames = NDArray[np.uint8]
GRAY, PHASE, BOTH = "gray", "phase", "gray+phase"
#: Faults and the codes that tell of them; what the sentence of a true cause holds.
KINDS: dict[str, tuple[tuple[str, ...], tuple[str, ...]]] = {
    "swapped": ((BOTH, PHASE, GRAY), ("each other's place",)),
    "lost": ((BOTH, PHASE, GRAY), ("missing",)),
    "doubled": ((BOTH, PHASE, GRAY), ("twice", "again")),
    "order reversed": ((BOTH, PHASE, GRAY), ("reverse order",)),
    "axes exchanged": ((BOTH, PHASE), ("axes",)),
    "inverted polarity": ((BOTH, GRAY), ("inverted",)),
    "white and black exchanged": ((BOTH, GRAY), ("white and black", "each other's place")),
    "sine for cosine": ((BOTH, PHASE), ("periods off",)),
    "period 2 % off": ((BOTH, PHASE), ("shown with about",)),
    "cells of 4 for 3": ((BOTH,), ("cell",)),
    "bits reversed": ((BOTH, GRAY), ("bits",)),
    "binary for Gray": ((BOTH, GRAY), ("binary",)),
    "mirrored code": ((BOTH,), ("mirrored",)),
    "frames stretched": ((BOTH, PHASE, GRAY), ("stretched",)),
    "window": ((BOTH, PHASE, GRAY), ("in a part", "in part")),
    "rolling rows": ((BOTH, PHASE, GRAY), ("in rows", "from about row")),
}
FINER, STEP = 1.02, math.pi / 2


@dataclass(frozen=True, slots=True)
class Structural:
    """kind: of KINDS; frame, other: of faults of frames; at: share of the rows from which on they roll."""

    kind: str
    frame: int = 0
    other: int = 0
    at: float = 0.5

    def shown(self, described: Sequence) -> Sequence:
        """What the surface shows."""
        change = _CHANGES.get(self.kind)
        if change is None:
            return described
        bits = {axis: 1 + max(f.bit or 0 for f in described.frames if f.axis == axis) for axis in "uv"}
        finest = min((f.period_px for f in described.frames if f.period_px is not None), default=0.0)
        extents = {"u": described.cols, "v": described.rows}
        frames = tuple(
            frame if frame.axis is None else change(frame, bits[frame.axis], finest, extents[frame.axis])
            for frame in described.frames
        )
        return replace(described, frames=frames)

    def spoil(self, frames: Frames, described: Sequence) -> Frames:
        """What the camera brings of it."""
        count = len(frames)
        if self.kind in ("swapped", "lost"):
            return Fault(self.kind, self.frame, self.other).spoil(frames)
        if self.kind == "doubled":
            return np.asarray(frames[[*range(self.frame + 1), *range(self.frame, count - 1)]])
        if self.kind == "order reversed":
            return np.ascontiguousarray(frames[::-1])
        if self.kind == "white and black exchanged":
            ends = [i for i, frame in enumerate(described.frames) if frame.kind in ("white", "black")]
            frames = frames.copy()
            frames[ends] = frames[ends[::-1]]
        elif self.kind == "frames stretched":
            low, high = (np.asarray(of(frames, axis=(1, 2)), np.float64) for of in (np.min, np.max))
            stretched = (frames - low[:, None, None]) * (255 / np.maximum(high - low, 1))[:, None, None]
            frames = np.rint(stretched).astype(np.uint8)
        elif self.kind == "rolling rows":
            start, frames = round(self.at * frames.shape[1]), frames.copy()
            frames[1:, start:] = frames[:-1, start:]
        return frames


def _mirrored(frame: Frame, bits: int, finest: float, extent: int) -> Frame:
    """A code from the other end."""
    if frame.bit is None:
        return frame
    cells = math.ceil(extent / frame.cell_px)
    cell = cells - 1 - np.arange(cells)
    levels = 255.0 * (((cell ^ (cell >> 1)) >> frame.bit) & 1)
    if frame.inverted:
        levels = 255.0 - levels
    return Frame("levels", frame.axis, cell_px=frame.cell_px, levels=tuple(levels.tolist()))


def _of_bits(frame: Frame, **changes: object) -> Frame:
    return replace(frame, **changes) if frame.bit is not None else frame  # type: ignore[arg-type]


def _of_fringes(frame: Frame, finest: float, **changes: object) -> Frame:
    return replace(frame, **changes) if frame.period_px == finest else frame  # type: ignore[arg-type]


#: Frame, bits of its axis' code, finest period and extent -> the frame that is shown instead.
_CHANGES = {
    "axes exchanged": lambda f, bits, finest, extent: _of_fringes(
        f, finest, axis="v" if f.axis == "u" else "u"
    ),
    "inverted polarity": lambda f, bits, finest, extent: _of_bits(f, inverted=not f.inverted),
    "sine for cosine": lambda f, bits, finest, extent: (
        f if f.shift is None else replace(f, shift=f.shift + STEP)
    ),
    "period 2 % off": lambda f, bits, finest, extent: _of_fringes(f, finest, period_px=FINER * finest),
    "cells of 4 for 3": lambda f, bits, finest, extent: _of_bits(f, cell_px=f.cell_px * 4 / 3),
    "bits reversed": lambda f, bits, finest, extent: _of_bits(f, bit=bits - 1 - (f.bit or 0)),
    "binary for Gray": lambda f, bits, finest, extent: _of_bits(f, kind="binary"),
    "mirrored code": _mirrored,
}


def drawn_structural(rng: np.random.Generator, number: int, count: int) -> Structural:
    """Kinds take turns."""
    kind = list(KINDS)[number % len(KINDS)]
    frame = int(rng.integers(2, count - 2))
    return Structural(
        kind,
        frame,
        frame - 1 if rng.random() < 0.5 else int(rng.integers(0, frame)),
        float(rng.uniform(0.2, 0.8)),
    )
