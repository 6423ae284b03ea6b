"""A camera that is not there and the display that it looks at: an image of whatever pattern is on show."""

import time

from ..capture import Image as Pixels
from ..devices import Accepted, Identity, Image, Shown, Wanted

__all__ = ["StillCamera"]


class StillCamera:
    """Camera and Display in one. Images cost no time, but for a rate that is asked for, and carry the time at
    which they are asked for.
    """

    lost = 0

    def __init__(self, identity: Identity, shape: tuple[int, int], bits: int) -> None:
        self._identity, self._shape, self._bits = identity, shape, bits
        self._index = self._count = 0
        self._period = self._last = 0.0

    @property
    def identity(self) -> Identity:
        """Who it is."""
        return self._identity

    @property
    def refresh_s(self) -> float | None:
        """Unknown."""
        return None

    def pixels(self, index: int) -> Pixels:
        """The image (H, W) of pattern `index`."""
        raise NotImplementedError

    def show(self, index: int) -> Shown:
        """Look at pattern `index` from now on."""
        self._index = index
        return Shown(index, time.monotonic())

    def configure(self, wanted: Wanted) -> Accepted:
        """The exposure is taken as it comes; size and bits are those of the images."""
        rows, cols = self._shape
        self._period = 0.0 if wanted.fps is None else 1 / wanted.fps
        return Accepted(
            wanted.exposure_s, rows, cols, bits=self._bits, fps=wanted.fps, trigger=wanted.trigger
        )

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
        return Image(self.pixels(self._index), self._count, None, now)

    def stop(self) -> None:
        """Nothing runs."""

    def close(self) -> None:
        """Nothing is open."""
