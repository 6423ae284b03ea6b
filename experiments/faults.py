"""Faults of frames: what displays, cameras and drivers do to a sequence."""

from dataclasses import dataclass
from typing import Any

from numpy.typing import NDArray

from optolever.patterns import Sequence

__all__ = ["Fault"]


@dataclass(frozen=True, slots=True)
class Fault:
    """kind: swapped (frame, other), twice (`frame` shows `other`), torn (so from row share `at` on) or lost.
    Where `frame` is lost all later ones arrive one place early, and the last one stays.

    shown: the display does it, so that a picture shown twice has noise of its own each time; else the camera
    delivers the same numbers twice.
    """

    kind: str
    frame: int
    other: int
    at: float = 0.0
    shown: bool = False

    def __str__(self) -> str:
        return f"{self.kind} {self.frame}" + ("" if self.kind == "lost" else f" {self.other}")

    def spoil(self, frames: NDArray[Any]) -> NDArray[Any]:
        """Frames (N, ...) with the fault."""
        spoilt, i, j = frames.copy(), self.frame, self.other
        if self.kind == "swapped":
            spoilt[[i, j]] = frames[[j, i]]
        elif self.kind == "lost":
            spoilt[i:-1] = frames[i + 1 :]
        else:
            start = round(self.at * frames.shape[1]) if self.kind == "torn" else 0
            spoilt[i, start:] = frames[j, start:]
        return spoilt

    def inverts(self, sequence: Sequence) -> bool:
        """Whether a bit and its own inverse are swapped, which may be another scene's perfect picture."""
        one, two = (sequence.frames[index] for index in (self.frame, self.other))
        return self.kind == "swapped" and one.bit is not None and (one.bit, one.axis) == (two.bit, two.axis)
