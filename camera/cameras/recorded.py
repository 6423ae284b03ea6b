"""A recording as a camera, the display that it looked at, and their clock: events come in their order."""

from collections.abc import Sequence
from pathlib import Path

from optolever.errors import InputError
from optolever.projector import Accepted, CameraLost, Identity, Image, Shown, Wanted

from ..recording import Logged, Recording

__all__ = ["Replay"]


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
            (one.image.pixels.shape for one in self.recording.images() if one.image.complete), (0, 0)
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
