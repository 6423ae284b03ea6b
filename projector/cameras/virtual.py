"""The virtual sensor as a camera: its image of the pattern on display."""

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
        """Free the sensor's memory."""
        self._sensor.release()
