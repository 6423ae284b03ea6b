"""The virtual sensor as a camera: what the scene's camera sees of the pattern that is on show."""

from ..capture import Image as Pixels
from ..devices import Identity
from ..virtual import VirtualSensor
from .still import StillCamera

__all__ = ["VirtualCamera"]


class VirtualCamera(StillCamera):
    """Looks at the patterns of the sensor's sequence; `close` frees the sensor."""

    def __init__(self, sensor: VirtualSensor) -> None:
        self._sensor = sensor
        super().__init__(Identity("virtual", "virtual sensor", "", "virtual"), sensor.shape, sensor.bits)

    def pixels(self, index: int) -> Pixels:
        """Rendered now."""
        return self._sensor.grab(index)

    def close(self) -> None:
        """Free what the sensor holds."""
        self._sensor.release()
