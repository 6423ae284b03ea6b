"""The images of a sequence: the record that the projector hands to the decoder."""

from __future__ import annotations

import operator
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Self, SupportsIndex, overload

import numpy as np
from numpy.typing import NDArray

from optolever.errors import InputError
from optolever.notices import Notice
from optolever.numbers import whole
from optolever.patterns import Sequence
from optolever.records import Axes, plot_maps
from optolever.scene import Scene, Trace

from .folder import Description, write_folder
from .reading import Source, described, read_frames, read_scene

__all__ = ["Capture", "Image"]

Image = NDArray[np.uint8] | NDArray[np.uint16]


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Capture:
    """Frames (N, H, W) of the N patterns of `sequence`, in its order.

    capture[3] is the image (H, W) of frame 3, as in an array; capture[2:5] a Capture of three frames, with
    their sequence and timestamps. len() and iteration are those of the images.

    frames: uint8 for 8 bits, else uint16 with values up to 2^bits - 1. bits: of the camera, 8 to 16.
    timestamps: (N,) seconds, middle of the exposure. scene: the known rig.
    notices: remarks on the files that it was read from.
    InputError names the field, its value and the limit.
    """

    frames: Image
    sequence: Sequence
    scene: Scene | None = None
    timestamps: NDArray[np.float64] | None = None
    bits: int = 8
    notices: tuple[Notice, ...] = ()

    def __post_init__(self) -> None:
        count = len(self.sequence)
        object.__setattr__(self, "bits", whole("bits", self.bits))
        if self.timestamps is not None:
            object.__setattr__(self, "timestamps", np.asarray(self.timestamps, np.float64))
        if self.frames.ndim != 3 or self.frames.shape[0] != count:
            raise InputError(f"frames: shape {self.frames.shape}, the sequence needs ({count}, H, W)")
        if not 8 <= self.bits <= 16:
            raise InputError(f"bits: {self.bits}, the limits are 8 and 16")
        expected = np.dtype(np.uint8 if self.bits == 8 else np.uint16)
        if self.frames.dtype != expected:
            raise InputError(f"frames: {self.frames.dtype}, {self.bits} bits need {expected}")
        if self.timestamps is not None and self.timestamps.shape != (count,):
            raise InputError(f"timestamps: shape {self.timestamps.shape}, must be one per frame: ({count},)")
        if self.timestamps is not None and not np.isfinite(self.timestamps).all():
            worst = int(np.argmin(np.isfinite(self.timestamps)))
            raise InputError(f"timestamps: {self.timestamps[worst]} of frame {worst}, must be finite")

    def __repr__(self) -> str:
        rows, cols = self.shape
        scene = "no scene" if self.scene is None else f"scene {self.scene.name}"
        return (
            f"Capture: {len(self)} frames of {rows} x {cols} pixels, {self.bits} bits, {scene}\n"
            f"  levels {self.frames.min()} to {self.frames.max()} of {self.white}\n"
            f"  of {self.sequence!r}"
        )

    def plot(self, axes: Any = None) -> Axes:
        """Draw the first and the last frame, and the contrast of all, in camera levels; the axes."""
        span = self.frames.max(axis=0).astype(np.int64) - self.frames.min(axis=0)
        maps = {"first frame [levels]": self.frames[0], "last frame [levels]": self.frames[-1]}
        return plot_maps({**maps, "brightest less darkest [levels]": span}, axes)

    def __len__(self) -> int:
        return int(self.frames.shape[0])

    @overload
    def __getitem__(self, index: SupportsIndex) -> Image: ...

    @overload
    def __getitem__(self, index: slice) -> Self: ...

    def __getitem__(self, index: SupportsIndex | slice) -> Image | Self:
        if not isinstance(index, slice):
            image: Image = self.frames[operator.index(index)]
            return image
        times = None if self.timestamps is None else self.timestamps[index]
        return replace(self, frames=self.frames[index], sequence=self.sequence[index], timestamps=times)

    def __iter__(self) -> Iterator[Image]:
        return iter(self.frames)

    @property
    def shape(self) -> tuple[int, int]:
        """(rows, cols) of the camera."""
        return int(self.frames.shape[1]), int(self.frames.shape[2])

    @property
    def white(self) -> int:
        """The greatest value that a pixel can have."""
        return int(2**self.bits - 1)

    def save(self, folder: str | Path, truth: Trace | None = None) -> None:
        """Write `capture.toml` and `frames/*.png`, with `scene.toml` and `truth.npz` where they are known.

        The folder must not hold files; it is complete or absent afterwards.
        """
        shown = Description(self.sequence, times=self.timestamps, bits=self.bits)
        write_folder(folder, self.frames, shown, self.scene, truth)

    @classmethod
    def load(
        cls, source: Source, description: str | Path | Sequence | None = None, *, channel: str = "luminance"
    ) -> Self:
        """Read a capture folder strictly, or pictures that another program took.

        description: the sequence whose patterns they show, one each, in that order, or a capture.toml; None:
        that of the folder. Where it names files, they are relative to the folder; else the pictures of a
        folder, a glob pattern, a file of several (TIFF, NPY, video), or files are taken, whose names are
        sorted as people count. channel: red, green, blue or luminance, of pictures in colour.
        InputError names file, field, value and limit, or the number of pictures and a remedy.
        """
        base, shown = described(source, description)
        if shown.sequence.packing is not None:
            cure = "optolever decode DIR --response RIG.toml makes frames of them"
            raise InputError(f"{description or base}: pictures of three frames each (version 2); {cure}")
        frames, bits, notices = read_frames(source, shown, channel, own=description is None)
        scene = read_scene(base, shown, frames)
        return cls(frames, shown.sequence, scene, shown.times, bits, notices)
