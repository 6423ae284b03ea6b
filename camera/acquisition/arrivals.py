"""The images of a running camera as they come, with their times: the one loop that waits for images."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

from optolever.projector import Camera, Display, Image, PatternWindow, Time

from .clocks import ClockMap, Stamp

__all__ = ["Arrivals", "OnImage"]

OnImage = Callable[[Image, float], None]


@dataclass(frozen=True, slots=True)
class Arrivals:
    """The images of a camera one by one, with their times. triggered: the camera waits for `trigger`;
    on_image: called with every image and its time; display: its window must
    stay open."""

    camera: Camera
    time: Time
    clock: ClockMap
    triggered: bool = False
    on_image: OnImage | None = None
    display: Display | None = None

    def next(self, timeout_s: float) -> Image | None:
        """The next image; a camera that waits for `trigger` is triggered first."""
        return next((image for image, _ in self.until(self.time.now() + timeout_s)), None)

    def stamped(self, until: float) -> tuple[Image, Stamp] | None:
        """The next image, complete or not; None if none came in time. CameraLost; InputError once the display
        is gone."""
        if isinstance(self.display, PatternWindow):
            self.display.require_open()
        now = self.time.now()
        self.clock.ask(now)
        image = self.camera.next(max(until - now, 0.0))
        if image is None:
            return None
        stamp = self.clock.stamp(image)
        if self.on_image is not None:
            self.on_image(image, stamp.time_s)
        return image, stamp

    def until(self, end: float) -> Iterator[tuple[Image, Stamp]]:
        """All images up to a time, triggered one after the other where the camera waits for it."""
        while self.time.now() < end:
            if self.triggered:
                self.camera.trigger()
            found = self.stamped(end)
            if found is not None:
                yield found
