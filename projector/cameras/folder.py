"""A capture folder as a camera: image k while pattern k is on show."""

from pathlib import Path

from ..capture import Capture
from ..capture import Image as Pixels
from ..devices import Identity
from .still import StillCamera

__all__ = ["FolderCamera"]


class FolderCamera(StillCamera):
    """Of the frames that a `capture.toml` describes. InputError as of Capture.load."""

    def __init__(self, folder: Path) -> None:
        self.capture = Capture.load(folder)
        identity = Identity("folder", str(folder), "", f"folder:{folder}")
        super().__init__(identity, self.capture.shape, self.capture.bits)

    def pixels(self, index: int) -> Pixels:
        """Frame `index`."""
        return self.capture[index]
