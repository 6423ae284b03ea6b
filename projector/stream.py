"""One thread for a camera: it pulls every image as it comes and hands it to who listens."""

from __future__ import annotations

import threading
from collections.abc import Callable
from types import TracebackType
from typing import Self

from optolever.errors import InputError

from .clocks import ClockMap, Stamp
from .devices import Camera, Image

__all__ = ["CameraStream"]

_PULL_S = 0.2

Listener = Callable[[Image, Stamp], None]


class CameraStream:
    """Begins and ends with its block. Listeners run in its thread and must be quick.

    images, incomplete: counts so far; failure: CameraLost, or an error of a listener, that ended it early;
    errors other than InputError and OSError are raised at the end of the block.
    """

    def __init__(self, camera: Camera, clock: ClockMap, *listeners: Listener) -> None:
        self._camera, self._clock, self._listeners = camera, clock, listeners
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._pull, name="camera", daemon=True)
        self.images = self.incomplete = 0
        self.failure: Exception | None = None

    def __enter__(self) -> Self:
        self._camera.start()
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stop.set()
        self._thread.join()
        self._camera.stop()
        if self.failure is not None and not isinstance(self.failure, InputError | OSError):
            raise self.failure

    @property
    def running(self) -> bool:
        """False once the camera was lost or a listener failed."""
        return self._thread.is_alive() and self.failure is None

    def _pull(self) -> None:
        try:
            while not self._stop.is_set():
                image = self._camera.next(_PULL_S)
                if image is None:
                    continue
                stamp = self._clock.stamp(image)
                self.images += 1
                self.incomplete += not image.complete
                for listener in self._listeners:
                    listener(image, stamp)
        except Exception as error:
            self.failure = error
