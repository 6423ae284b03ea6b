"""Records and protocols of cameras, displays and clocks. Times are CLOCK_MONOTONIC, in seconds."""

import time
from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from optolever.errors import InputError

__all__ = [
    "Accepted", "Camera", "CameraLost", "Display", "Identity", "Image", "RealTime", "Shown", "Time",
    "Wanted",
]  # fmt: skip


class CameraLost(InputError):
    """The camera does not answer any more: unplugged, without power, or its driver gone."""


@dataclass(frozen=True, slots=True)
class Identity:
    """address: value of camera in [devices]; note: why it cannot be opened now ("busy", "no permission");
    formats: of its pixels, as the driver names them.
    """

    backend: str
    model: str
    serial: str
    address: str
    note: str = ""
    formats: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Wanted:
    """Settings of a camera. gain: None keeps it; fps: None is the highest; rows, cols: 0 is the full
    sensor; trigger: free, software or hardware; focus: in the driver's units, None keeps it; format: of a
    webcam's pixels, as the driver names it ("MJPG"); empty: the best raw one. colour: three channels, raw
    where the camera can.
    """

    exposure_s: float
    rows: int = 0
    cols: int = 0
    row: int = 0
    col: int = 0
    bits: int = 8
    gain: float | None = None
    fps: float | None = None
    trigger: str = "free"
    focus: int | None = None
    format: str = ""
    colour: bool = False


@dataclass(frozen=True, slots=True)
class Accepted(Wanted):
    """Settings as read back from the camera. unlocked: settings that may change, with the reason
    ("exposure: the driver has no control"). mosaic: order of colours in raw pixels ("RGGB", rows and cols are
    the pixels'); "RGB": three values in each, "YUYV": two of them averaged; empty: grey.
    """

    unlocked: tuple[str, ...] = ()
    mosaic: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class Image:
    """pixels (H, W), or (H, W, 3) of colours, uint8 or uint16, empty where the image is not complete; id:
    counter of the camera; device_s: stamp of its clock; arrived_s: host time of arrival; why: its fault.
    """

    pixels: NDArray[Any]
    id: int | None
    device_s: float | None
    arrived_s: float
    complete: bool = True
    why: str = ""


@dataclass(frozen=True, slots=True)
class Shown:
    """A frame on the display: when its swap was done; late: over 1.5 refreshes after it was asked for."""

    index: int
    swapped_s: float
    late: bool = False


@runtime_checkable
class Camera(Protocol):
    """A camera. `lost`: images that it took and that never came, by gaps of its counter."""

    @property
    def identity(self) -> Identity:
        """Who it is."""

    @property
    def lost(self) -> int:
        """Images that were taken and never came."""

    def configure(self, wanted: Wanted) -> Accepted:
        """Set everything, automatic controls off; returns the settings read back."""

    def start(self) -> None:
        """Begin to take images."""

    def trigger(self) -> float:
        """Ask for one image (software trigger); when it was asked."""

    def next(self, timeout_s: float) -> Image | None:
        """The next image, complete or not; None if none came in time. CameraLost."""

    def stop(self) -> None:
        """Take no more images."""

    def close(self) -> None:
        """Give the camera back."""


@runtime_checkable
class Display(Protocol):
    """A display of patterns."""

    @property
    def refresh_s(self) -> float | None:
        """Period; None where it is unknown."""

    def show(self, index: int) -> Shown:
        """Put frame `index` on the surface."""


@runtime_checkable
class Time(Protocol):
    """A clock, so that simulated time drives the same logic."""

    def now(self) -> float:
        """Seconds."""

    def wait(self, until: float) -> None:
        """Return at that time."""


class RealTime:
    """CLOCK_MONOTONIC."""

    def now(self) -> float:
        """Seconds."""
        return time.monotonic()

    def wait(self, until: float) -> None:
        """Return at that time."""
        if (left := until - time.monotonic()) > 0:
            time.sleep(left)


def no_pixels() -> NDArray[np.uint8]:
    """Pixels of an image that is not complete."""
    return np.empty((0, 0), np.uint8)
