"""Cameras that are not there: the images of a capture; a recording, whose events come in their order."""

import time
from collections.abc import Sequence
from pathlib import Path

from optolever.errors import InputError
from optolever.projector import Accepted, CameraLost, Capture, ColourCapture, Identity, Image, Shown, Wanted

from ..recording import Logged, Recording

__all__ = ["Replay", "StillCamera"]


class Replay:
    """Camera, Display and Time in one, so that a recorded run repeats identically."""

    lost = 0

    def __init__(self, folder: Path) -> None:
        self.recording = Recording(folder)
        self._events: Sequence[Shown | Logged] = list(self.recording)
        self._next, self._now = 0, 0.0
        first = next((one for one in self._events if isinstance(one, Logged)), None)
        if first is None:
            raise InputError(f"{folder}: holds no image")
        self._shape = next(
            (one.image.pixels.shape[:2] for one in self.recording.images() if one.image.complete), (0, 0)
        )

    @property
    def identity(self) -> Identity:
        """Its folder."""
        folder = self.recording.folder
        return Identity("replay", str(self.recording.about.get("camera", folder)), "", f"replay:{folder}")

    @property
    def refresh_s(self) -> float | None:
        """Of the display at the recording."""
        value = self.recording.about.get("refresh_s")
        return None if value is None else float(value)

    @property
    def swaps(self) -> bool:
        """Whether it holds swaps; else one frame was on show all the time."""
        return any(isinstance(event, Shown) for event in self._events)

    @property
    def over(self) -> bool:
        """Whether no event follows."""
        return self._next >= len(self._events)

    def now(self) -> float:
        """Time of the last event."""
        return self._now

    def wait(self, until: float) -> None:
        """Go there."""
        self._now = max(self._now, until)

    def show(self, index: int) -> Shown:
        """The next swap of the recording to that frame; of a recording without swaps, now. CameraLost where
        there is none."""
        if not self.swaps:
            event = None if self.over else self._events[self._next]
            if isinstance(event, Logged):
                self._now = max(self._now, event.stamp_s)
            return Shown(index, self._now)
        for place in range(self._next, len(self._events)):
            event = self._events[place]
            if isinstance(event, Shown) and event.index == index:
                self._next, self._now = place + 1, event.swapped_s
                return event
        raise CameraLost(f"{self.recording.folder}: the recording ends before frame {index} is shown (again)")

    def configure(self, wanted: Wanted) -> Accepted:
        """The recorded settings, for any request."""
        rows, cols = self._shape
        return self.recording.accepted or Accepted(wanted.exposure_s, rows, cols)

    def start(self) -> None:
        """Stands where it stands."""

    def trigger(self) -> float:
        """No effect: the recorded images come anyway."""
        return self._now

    def next(self, timeout_s: float) -> Image | None:
        """The next image before the next swap; None where there is none in time, or no more."""
        event = self._events[self._next] if self._next < len(self._events) else None
        if event is None or isinstance(event, Shown) or event.image.arrived_s > self._now + timeout_s:
            self._now += timeout_s
            return None
        self._next += 1
        self._now = max(self._now, event.image.arrived_s)
        return event.image

    def stop(self) -> None:
        """Nothing runs."""

    def close(self) -> None:
        """Nothing is open but the file."""


class StillCamera:
    """Camera and Display in one. Images cost no time, but for a rate that is asked for, and carry the time at
    which they are asked for.
    """

    lost = 0

    def __init__(self, capture: Capture | ColourCapture, identity: Identity) -> None:
        self._images = capture.images if isinstance(capture, ColourCapture) else capture.frames
        self._mosaic = capture.mosaic if isinstance(capture, ColourCapture) else ""
        self._bits, self.identity = capture.bits, identity
        self._index = self._count = 0
        self._period = self._last = 0.0

    @property
    def refresh_s(self) -> float | None:
        """Unknown."""
        return None

    def show(self, index: int) -> Shown:
        """Look at pattern `index` from now on."""
        self._index = index
        return Shown(index, time.monotonic())

    def configure(self, wanted: Wanted) -> Accepted:
        """The exposure is taken as it comes; size and bits are those of the images."""
        self._period = 0.0 if wanted.fps is None else 1 / wanted.fps
        rows, cols = self._images.shape[1:3]
        return Accepted(
            wanted.exposure_s, rows, cols, bits=self._bits, fps=wanted.fps, trigger=wanted.trigger,
            mosaic=self._mosaic,
        )  # fmt: skip

    def start(self) -> None:
        """Always runs."""

    def trigger(self) -> float:
        """Now."""
        return time.monotonic()

    def next(self, timeout_s: float) -> Image | None:
        """An image of the pattern on show, at the rate that was asked for."""
        if (left := self._last + self._period - time.monotonic()) > 0:
            time.sleep(min(left, timeout_s))
            if left > timeout_s:
                return None
        now = self._last = time.monotonic()
        self._count += 1
        return Image(self._images[self._index], self._count, now, now)

    def stop(self) -> None:
        """Nothing runs."""

    def close(self) -> None:
        """Nothing is open."""
