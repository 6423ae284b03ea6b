"""Monitors: name, model and serial (EDID), size, refresh, levels; settings that distort patterns."""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from optolever.errors import InputError

__all__ = ["Monitor", "choose_monitor", "edid_of", "parsed_edid"]

_STRAIGHT = 0.004  # of full scale: one of 255 levels


@dataclass(frozen=True, slots=True)
class Monitor:
    """A connected display.

    index: for PatternWindow; name: as the window system calls it (under X11 the output);
    model, serial: by the monitor's EDID, empty where it cannot be read;
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
    model: str = ""
    serial: str = ""

    @property
    def address(self) -> str:
        """MODEL:SERIAL, which the next plugging keeps; where EDID lacks one, the name."""
        return f"{self.model}:{self.serial}" if self.model and self.serial else self.name

    def __str__(self) -> str:
        refresh = f"{self.refresh_hz} Hz" if self.refresh_hz else "refresh unknown"
        size = f", {self.rows_mm} x {self.cols_mm} mm" if self.rows_mm else ""
        output = "" if self.address == self.name else f"{self.name}, "
        return f"{self.address} ({output}{self.rows} x {self.cols}, {refresh}{size}, {self.bits} bits)"

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
    """The monitor of that address, name or model. InputError if there is none, or several."""
    for name in ("address", "name", "model"):
        fitting = [one for one in found if getattr(one, name) == text]
        if len(fitting) == 1:
            return fitting[0]
        if fitting:
            addresses = [one.address for one in fitting]
            told = addresses if len({*addresses}) == len(addresses) else [one.name for one in fitting]
            cure = f"name one: {', '.join(told)}" if len({*told}) == len(told) else "unplug the others"
            raise InputError(f"display: {len(fitting)} monitors are called {text!r}: {cure}")
    known = ", ".join(one.address for one in found) or "none"
    raise InputError(f"display: {text!r} is not connected, there is {known}")


def edid_of(output: str, folder: Path = Path("/sys/class/drm")) -> tuple[str, str]:
    """Model and serial of the monitor at an output, by the kernel's copy of its EDID; empty: unknown."""
    for path in sorted(folder.glob("card*-*/edid")):
        connector = path.parent.name.partition("-")[2]
        if _plain(connector) == _plain(output):
            with suppress(OSError):
                return parsed_edid(path.read_bytes())
    return "", ""


def _plain(output: str) -> str:
    """Drivers call one output HDMI-A-1, HDMI-1 and HDMI1."""
    return output.replace("-A-", "-").replace("-", "")


def parsed_edid(data: bytes) -> tuple[str, str]:
    """Model and serial: texts of the descriptors, else the serial number (VESA E-EDID, 3.4, 3.10.3)."""
    if len(data) < 128 or data[:8] != bytes([0, *[255] * 6, 0]):
        return "", ""
    texts = {}
    for at in (54, 72, 90, 108):
        if data[at : at + 3] == bytes(3):
            texts[data[at + 3]] = (
                data[at + 5 : at + 18].partition(b"\n")[0].decode("ascii", "replace").strip()
            )
    number = int.from_bytes(data[12:16], "little")
    return texts.get(0xFC, ""), texts.get(0xFF, "") or (str(number) if number else "")
