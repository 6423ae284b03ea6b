"""The seam for real rigs: where frames come from, what shows the patterns, and how both make a capture."""

from pathlib import Path
from typing import Protocol, runtime_checkable

import numpy as np

from optolever.patterns import Sequence

from .capture import Capture, Image

__all__ = ["FolderSource", "FrameSource", "PatternDisplay", "record"]


@runtime_checkable
class FrameSource(Protocol):
    """A camera: the virtual sensor, a folder of frames, later a real one."""

    @property
    def shape(self) -> tuple[int, int]:
        """(rows, cols)."""

    @property
    def bits(self) -> int:
        """8 to 16; frames are uint8 for 8, else uint16."""

    def grab(self, index: int) -> Image:
        """The image (H, W) of frame `index` of the sequence, which is on show now."""


@runtime_checkable
class PatternDisplay(Protocol):
    """What shows a sequence; PatternWindow is one."""

    def show(self, index: int) -> None:
        """Put frame `index` on the surface; returns when it is there."""


class FolderSource:
    """Frames from a capture folder, as a camera would hand them out."""

    def __init__(self, folder: str | Path, description: str | Path | None = None) -> None:
        self._capture = Capture.load(folder, description)

    @property
    def shape(self) -> tuple[int, int]:
        """(rows, cols)."""
        return self._capture.shape

    @property
    def bits(self) -> int:
        """Of the camera that took the frames."""
        return self._capture.bits

    @property
    def sequence(self) -> Sequence:
        """What was shown."""
        return self._capture.sequence

    def grab(self, index: int) -> Image:
        """The image (H, W) of frame `index`."""
        image: Image = self._capture.frames[index]
        return image


def record(source: FrameSource, sequence: Sequence, display: PatternDisplay | None = None) -> Capture:
    """Show the frames one by one and grab an image of each. display None: the source shows them itself."""
    frames = np.empty((len(sequence), *source.shape), np.uint8 if source.bits == 8 else np.uint16)
    for index in range(len(sequence)):
        if display is not None:
            display.show(index)
        frames[index] = source.grab(index)
    return Capture(frames, sequence, bits=source.bits)
