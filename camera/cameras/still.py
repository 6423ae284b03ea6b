"""A camera that is not there and the display that it looks at: the images of a capture."""

import time

from optolever.projector import Accepted, Capture, Identity, Image, Shown, Wanted

__all__ = ["StillCamera"]


class StillCamera:
    """Camera and Display in one. Images cost no time, but for a rate that is asked for, and carry the time at
    which they are asked for.
    """

    lost = 0

    def __init__(self, capture: Capture, identity: Identity) -> None:
        self._capture, self.identity = capture, identity
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
        bits, size = self._capture.bits, self._capture.shape
        return Accepted(wanted.exposure_s, *size, bits=bits, fps=wanted.fps, trigger=wanted.trigger)

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
        return Image(self._capture[self._index], self._count, now, now)

    def stop(self) -> None:
        """Nothing runs."""

    def close(self) -> None:
        """Nothing is open."""
