"""Pictures of a sequence in colour, whose levels are kept as taken: frames are made of them by the colours'
response of the rig."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from optolever.errors import InputError
from optolever.patterns import Sequence
from optolever.scene import MOSAICS, Scene, Trace

from .capture import Capture
from .folder import DESCRIPTION, Description, in_colour, write_folder
from .reading import Source, described, read_frames, read_scene
from .unmixing import ColourResponse, unmixed

__all__ = ["ColourCapture", "load_capture"]


@dataclass(frozen=True, slots=True, eq=False)
class ColourCapture:
    """Pictures (E, H, W, 3), or (E, 2 H, 2 W) of a mosaic, of the E exposures of `sequence`; scene: the known
    rig, whose camera has H x W pixels; timestamps (E,), s; bits: of the camera; mosaic: as it named it,
    empty: unknown."""

    images: NDArray[np.uint8] | NDArray[np.uint16]
    sequence: Sequence
    scene: Scene | None = None
    timestamps: NDArray[np.float64] | None = None
    bits: int = 8
    mosaic: str = ""

    @property
    def raw(self) -> str | None:
        """One of MOSAICS, of raw pictures; None: three values in every pixel, or unknown."""
        return self.mosaic if self.mosaic in MOSAICS else None

    @property
    def shape(self) -> tuple[int, int]:
        """(rows, cols) of the pictures."""
        return int(self.images.shape[1]), int(self.images.shape[2])

    def unmixed(self, response: ColourResponse) -> Capture:
        """The frames of a grey camera, by a measured response. InputError where that is of other pictures."""
        if self.mosaic and self.raw != response.mosaic:
            kind, cure = response.mosaic or "RGB", "measure it again: optolever response --colour"
            raise InputError(f"colour: pictures are {self.mosaic}, the response is of {kind}; {cure}")
        found = unmixed(self.images, self.sequence, response, bits=self.bits)
        return replace(found, scene=self.scene)

    def save(self, folder: str | Path, truth: Trace | None = None) -> None:
        """Write `capture.toml` and `images/*.png`, with `scene.toml` and `truth.npz` where they are known."""
        shown = Description(self.sequence, times=self.timestamps, bits=self.bits, mosaic=self.mosaic)
        write_folder(folder, self.images, shown, self.scene, truth)

    @classmethod
    def load(cls, source: Source, description: str | Path | None = None) -> ColourCapture:
        """Read as `Capture.load`, pictures that are not compressed with loss."""
        base, shown = described(source, description)
        if shown.sequence.packing is None:
            raise InputError(f"{description or base}: is in grey, must be in colour (version 2)")
        images, bits, _ = read_frames(source, shown)
        return cls(images, shown.sequence, read_scene(base, shown, images), shown.times, bits, shown.mosaic)


def load_capture(
    folder: Source,
    description: str | Path | None = None,
    channel: str = "luminance",
    colours: ColourResponse | None = None,
) -> Capture:
    """`Capture.load`, or the frames of pictures in colour, by the colours' response of their rig."""
    base = Path(folder) if isinstance(folder, str | Path) else Path(folder[0])
    toml = base / DESCRIPTION if description is None else Path(description)
    if not in_colour(toml):
        return Capture.load(folder, description, channel=channel)
    taken = ColourCapture.load(folder, description)
    if colours is None:
        cure = "name the rig (decode --response RIG.toml) in which optolever response --colour stored it"
        raise InputError(f"{toml}: three frames in a picture need the response of the colours; {cure}")
    return taken.unmixed(colours)
