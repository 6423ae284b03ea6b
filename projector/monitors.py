"""Monitors: identity by EDID, size, refresh, levels; settings that distort patterns."""

import re
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from optolever.errors import InputError

from .edid import Edid, parse_edid

__all__ = ["Monitor", "choose_monitor", "identified"]

_STRAIGHT = 0.004  # of full scale: one of 255 levels
_SYSFS = Path("/sys/class/drm")


@dataclass(frozen=True, slots=True)
class Monitor:
    """A connected display.

    index: for PatternWindow; name: of its EDID, else of the output; output: as the window system calls it;
    rows, cols: of its present mode; refresh_hz: 0 is unknown; rows_mm, cols_mm: 0 is unknown; scale: of the
    desktop; bits: per channel; bend: largest departure of the graphics card's level ramp from a straight
    line, of full scale; own_rows, own_cols: of the panel, 0 is unknown.
    """

    index: int
    name: str
    rows: int
    cols: int
    refresh_hz: int
    output: str = ""
    serial: str = ""
    rows_mm: int = 0
    cols_mm: int = 0
    scale: float = 1.0
    bits: int = 8
    bend: float = 0.0
    own_rows: int = 0
    own_cols: int = 0

    @property
    def address(self) -> str:
        """Value of display in [devices], and of show --display."""
        return f"{self.name}:{self.serial}" if self.serial else self.name

    def __str__(self) -> str:
        refresh = f"{self.refresh_hz} Hz" if self.refresh_hz else "refresh unknown"
        size = f", {self.rows_mm} x {self.cols_mm} mm" if self.rows_mm else ""
        return f"{self.address} ({self.rows} x {self.cols}, {refresh}{size}, {self.bits} bits)"

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
        if self.own_rows and (self.own_rows, self.own_cols) != (self.rows, self.cols):
            found.append(
                f"{self.name} shows {self.rows} x {self.cols} on a panel of "
                f"{self.own_rows} x {self.own_cols}: "
                "set its own resolution"
            )
        if self.scale != 1:
            found.append(f"the desktop scales {self.name} by {self.scale:g}: set the scale to 1")
        return tuple(found)


def choose_monitor(found: Sequence[Monitor], text: str) -> Monitor:
    """The monitor whose name, name:serial, serial or output that is. InputError if it is none or several."""
    fitting = [one for one in found if text in (one.address, one.name, one.serial, one.output) and text]
    known = ", ".join(one.address for one in found) or "none"
    if not fitting:
        raise InputError(f"display: {text!r} is not connected, there is {known}")
    if len(fitting) > 1:
        outputs = ", ".join(one.output for one in fitting)
        raise InputError(f"display: {len(fitting)} monitors are called {text!r}; name the output: {outputs}")
    return fitting[0]


def identified(plain: Mapping[str, Any], sysfs: Path = _SYSFS) -> Monitor:
    """A monitor as the window system describes it, with its EDID's data."""
    monitor = Monitor(**plain)
    edid = _edids(sysfs).get(_connector(monitor.output))
    if edid is None:
        return monitor
    return replace(
        monitor,
        name=edid.name or monitor.name,
        serial=edid.serial,
        rows_mm=edid.height_mm or monitor.rows_mm,
        cols_mm=edid.width_mm or monitor.cols_mm,
        own_rows=edid.rows,
        own_cols=edid.cols,
    )


def _edids(sysfs: Path) -> dict[str, Edid]:
    """Of every connector of the kernel that has one."""
    found = {}
    for file in sorted(sysfs.glob("card*-*/edid")):
        with suppress(OSError, InputError):
            found[_connector(file.parent.name.partition("-")[2])] = parse_edid(file.read_bytes())
    return found


def _connector(name: str) -> str:
    """One name for the kernel's HDMI-A-1 and the X server's HDMI-1."""
    return re.sub(r"^(HDMI|DVI)-[A-Z]-", r"\1-", name)
