"""Monitors: name, size, refresh, levels; settings that distort patterns."""

from collections.abc import Sequence
from dataclasses import dataclass

from optolever.errors import InputError

__all__ = ["Monitor", "choose_monitor"]

_STRAIGHT = 0.004  # of full scale: one of 255 levels


@dataclass(frozen=True, slots=True)
class Monitor:
    """A connected display.

    index: for PatternWindow; name: as the window system calls it;
    rows, cols: of its present mode; refresh_hz: 0 is unknown; rows_mm, cols_mm: 0 is unknown; scale: of the
    desktop; bits: per channel; bend: largest departure of the graphics card's level ramp from a straight
    line, of full scale.
    """

    index: int
    name: str
    rows: int
    cols: int
    refresh_hz: int
    rows_mm: int = 0
    cols_mm: int = 0
    scale: float = 1.0
    bits: int = 8
    bend: float = 0.0

    def __str__(self) -> str:
        refresh = f"{self.refresh_hz} Hz" if self.refresh_hz else "refresh unknown"
        size = f", {self.rows_mm} x {self.cols_mm} mm" if self.rows_mm else ""
        return f"{self.name} ({self.rows} x {self.cols}, {refresh}{size}, {self.bits} bits)"

    def faults(self) -> tuple[str, ...]:
        """Settings that distort levels or resample pixels: a sentence each, with its cure."""
        found = []
        if self.bend > _STRAIGHT:
            found.append(
                f"the graphics card bends the levels of {self.name} by up to {100 * self.bend:.0f} % of full "
                "scale: switch off night light and colour profiles"
            )
        if self.bits < 8:
            found.append(
                f"{self.name} has {self.bits} bits per channel, patterns need 8: choose 24-bit colour"
            )
        if self.scale != 1:
            found.append(f"the desktop scales {self.name} by {self.scale:g}: set the scale to 1")
        return tuple(found)


def choose_monitor(found: Sequence[Monitor], text: str) -> Monitor:
    """The monitor of that name. InputError if there is none, or several."""
    fitting = [one for one in found if one.name == text]
    if not fitting:
        known = ", ".join(one.name for one in found) or "none"
        raise InputError(f"display: {text!r} is not connected, there is {known}")
    if len(fitting) > 1:
        raise InputError(f"display: {len(fitting)} monitors are called {text!r}: unplug the others")
    return fitting[0]
