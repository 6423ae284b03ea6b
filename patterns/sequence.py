"""Sequence: the frames that go together, and the size of the surface that shows them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, SupportsIndex, cast, overload

import cv2
import numpy as np
import tomli_w
from numpy.typing import NDArray

from optolever.errors import InputError
from optolever.files import atomic_file, atomic_folder
from optolever.numbers import whole
from optolever.records import Axes, plot_maps
from optolever.toml import read_toml

from .channels import Packing, at_stripe
from .frame import Frame, frame_tables

__all__ = ["Sequence"]


@dataclass(frozen=True, slots=True, repr=False)
class Sequence:
    """Frames in the order of showing, on a surface of rows x cols pixels.

    sequence[3] is a Frame, sequence[2:5] a Sequence of three frames; len() and iteration as of a tuple.

    nominal: rows and cols are only the unit of the coordinates (a foreign capture of an unknown display), and
    say nothing about the cells of the display. packing: the frames of each exposure, of a sequence in colour
    (`packed`); None: each frame is an exposure of its own, in grey.

    >>> fringe = Frame("phase", "u", period_px=16.0, shift=0.0)
    >>> Sequence((fringe,), rows=4, cols=8).render()[0, 0].tolist()
    [255, 245, 218, 176, 128, 79, 37, 10]
    """

    frames: tuple[Frame, ...]
    rows: int
    cols: int
    name: str = "custom"
    nominal: bool = False
    packing: Packing | None = None
    _hash: int | None = field(init=False, repr=False, compare=False, default=None)

    def __post_init__(self) -> None:
        object.__setattr__(self, "frames", tuple(self.frames))
        if not self.frames:
            raise InputError("sequence: frames is empty, must hold at least one frame")
        for name in ("rows", "cols"):
            size = whole(f"sequence: {name}", getattr(self, name))
            if not 1 <= size <= 1 << 16:
                raise InputError(f"sequence: {name} is {size}, must be in 1..{1 << 16}")
            object.__setattr__(self, name, size)
        object.__setattr__(self, "nominal", bool(self.nominal))
        if self.packing is not None:
            self.packing.require(len(self.frames))

    def __repr__(self) -> str:
        counts = Counter((frame.kind, frame.axis) for frame in self.frames)
        kinds = ", ".join(f"{n} {kind}{f' {axis}' if axis else ''}" for (kind, axis), n in counts.items())
        return f"Sequence {self.name!r}: {len(self)} frames of {self.rows} x {self.cols} pixels: {kinds}"

    def plot(self, axes: Any = None) -> Axes:
        """Draw the frames, four at most, evenly chosen, in grey levels; the axes."""
        chosen = np.unique(np.linspace(0, len(self) - 1, min(4, len(self))).round().astype(int))
        return plot_maps(
            {f"frame {i + 1}: {self.frames[i].kind}": self.render_frame(i) for i in chosen}, axes
        )

    def __hash__(self) -> int:
        """Computed once: results derived from a sequence are repeatedly looked up by it."""
        if self._hash is None:
            own = hash((self.frames, self.rows, self.cols, self.name, self.nominal, self.packing))
            object.__setattr__(self, "_hash", own)
        return cast(int, self._hash)

    def __reduce__(self) -> tuple[Any, ...]:
        """Anew, as hashes of text differ from process to process."""
        return Sequence, (self.frames, self.rows, self.cols, self.name, self.nominal, self.packing)

    def __len__(self) -> int:
        return len(self.frames)

    @overload
    def __getitem__(self, index: SupportsIndex) -> Frame: ...

    @overload
    def __getitem__(self, index: slice) -> Sequence: ...

    def __getitem__(self, index: SupportsIndex | slice) -> Frame | Sequence:
        if isinstance(index, slice):
            return replace(self, frames=self.frames[index], packing=None)
        return self.frames[index]

    def __iter__(self) -> Iterator[Frame]:
        return iter(self.frames)

    @property
    def shape(self) -> tuple[int, int, int]:
        """(N, rows, cols), the shape of render()."""
        return len(self.frames), self.rows, self.cols

    @property
    def exposures(self) -> int:
        """Number of pictures that a camera takes of it: a third of the frames, and a few, in colour."""
        return len(self.frames) if self.packing is None else len(self.packing.exposures)

    def tables(self) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
        """Grey values along u (N, cols) and along v (N, rows)."""
        pairs = [frame_tables(frame, self.rows, self.cols) for frame in self.frames]
        return np.stack([pair[0] for pair in pairs]), np.stack([pair[1] for pair in pairs])

    def render_frame(self, index: int) -> NDArray[np.uint8]:
        """The image of one frame, (rows, cols)."""
        frame = self.frames[index]
        table_u, table_v = frame_tables(frame, self.rows, self.cols)
        along_u = table_u[None, :].astype(np.uint16)
        along_v = table_v[:, None].astype(np.uint16)
        if frame.combine == "mean":
            return ((along_u + along_v + 1) // 2).astype(np.uint8)
        # 255 * 255 + 127 still fits 16 bits
        return ((along_u * along_v + np.uint16(127)) // np.uint16(255)).astype(np.uint8)

    def render(self) -> NDArray[np.uint8]:
        """All images, (N, rows, cols)."""
        images = np.empty(self.shape, np.uint8)
        for index in range(len(self.frames)):
            images[index] = self.render_frame(index)
        return images

    def channel(self, number: int) -> Sequence:
        """Of a sequence in colour: the frames that channel 0, 1 or 2 (red, green, blue) displays, an exposure
        after the other, fringes along u at the places of that channel's stripes."""
        packing = self.packing or Packing(tuple((i, i, i) for i in range(len(self.frames))))
        own = [self.frames[exposure[number]] for exposure in packing.exposures]
        shown = tuple(at_stripe(frame, number, packing.stripes) for frame in own)
        return replace(self, frames=shown, packing=None)

    def pictures(self) -> Iterator[NDArray[np.uint8]]:
        """What the display shows, in the order of time: grey (rows, cols), or in colour (rows, cols, 3)."""
        if self.packing is None:
            yield from (self.render_frame(index) for index in range(len(self.frames)))
            return
        channels = [self.channel(number) for number in range(3)]
        for index in range(len(channels[0])):
            yield np.stack([channel.render_frame(index) for channel in channels], axis=-1)

    def save_png(self, folder: str | Path) -> None:
        """Write 000.png, 001.png, ... and sequence.toml into a new folder, for other displays."""
        with atomic_folder(folder) as target:
            for index, picture in enumerate(self.pictures()):
                _, data = cv2.imencode(".png", picture[..., ::-1] if picture.ndim == 3 else picture)
                (target / f"{index:03d}.png").write_bytes(data.tobytes())
            (target / "sequence.toml").write_text(tomli_w.dumps(self.to_dict()), encoding="utf-8")

    def save(self, path: str | Path) -> None:
        """Write the description as TOML, atomically."""
        with atomic_file(path) as temporary:
            temporary.write_text(tomli_w.dumps(self.to_dict()), encoding="utf-8")

    @classmethod
    def load(cls, path: str | Path) -> Sequence:
        """Read a file of save() or save_png(); InputError names the file, the field and its value."""
        return cls.from_dict(read_toml(path), str(path))

    def to_dict(self) -> dict[str, Any]:
        """Plain TOML types."""
        frames = [frame.to_dict() for frame in self.frames]
        plain = {"name": self.name, "rows": self.rows, "cols": self.cols, "frames": frames}
        more = {} if self.packing is None else {"packing": self.packing.to_dict()}
        return plain | ({"nominal": True} if self.nominal else {}) | more

    @classmethod
    def from_dict(cls, plain: Mapping[str, Any], where: str = "sequence") -> Sequence:
        """Inverse of to_dict; InputError names `where`, the field and its value."""
        known = ("name", "rows", "cols", "nominal", "frames", "packing")
        for name in plain:
            if name not in known:
                raise InputError(f"{where}: unknown field {name!r}, known are {', '.join(known)}")
        for name in ("rows", "cols"):
            value = plain.get(name)
            if not isinstance(value, int) or isinstance(value, bool) or not 1 <= value <= 1 << 16:
                raise InputError(f"{where}: {name} is {value!r}, must be a whole number in 1..{1 << 16}")
        frames = plain.get("frames")
        if not isinstance(frames, list | tuple) or not all(isinstance(item, Mapping) for item in frames):
            raise InputError(f"{where}: frames is {type(frames).__name__}, must be a list of tables")
        name = plain.get("name", "custom")
        if not isinstance(name, str):
            raise InputError(f"{where}: name is {name!r}, must be text")
        nominal = plain.get("nominal", False)
        if not isinstance(nominal, bool):
            raise InputError(f"{where}: nominal is {nominal!r}, must be true or false")
        described = tuple(Frame.from_dict(item, f"{where}: frames[{i}]") for i, item in enumerate(frames))
        own = plain.get("packing")
        packing = None if own is None else Packing.from_dict(own, where)
        return cls(described, plain["rows"], plain["cols"], name, nominal, packing)
