"""Frame: one image to show, described completely, its plain form for TOML, and its grey values.

The image is made of one 1-D table of grey values per axis, made here and nowhere else.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from optolever.errors import InputError
from optolever.numbers import real, whole

from .codes import code_words

__all__ = ["KINDS", "Frame", "frame_tables", "lattice_lines"]

Table = NDArray[np.uint8]
Levels = NDArray[np.float64]

#: Required fields of every kind. Optional fields have defaults in Frame.
KINDS: dict[str, tuple[str, ...]] = {
    "white": (),
    "black": (),
    "uniform": ("level",),
    "stripe": ("axis", "width_px"),
    "binary": ("axis", "bit"),
    "gray": ("axis", "bit"),
    "long-run-gray": ("axis", "bit"),
    "phase": ("axis", "period_px", "shift"),
    "crossed": ("period_px",),
    "lattice": ("period_px", "width_px"),
    "levels": ("axis", "levels"),
}
_AXES: dict[str, tuple[str | None, ...]] = {
    "white": (None,),
    "black": (None,),
    "uniform": (None,),
    "crossed": (None, "uv"),
    "lattice": (None, "uv"),
}
#: Cells, radians or factors at most: beyond, a float holds no millionth of them. A surface displays no
#: fringe of half a cell or less; indices of cells or stripes below a millionth exceed a float's integers.
_MOST, _LEAST_PERIOD, _LEAST_WIDTH = 1e9, 0.5, 1e-6
_TIE = 1e-9  # levels: so near to a half is one; cosines of thousands of cells are off by 1e-11


@dataclass(frozen=True, slots=True)
class Frame:
    """One image. Coordinates are pattern pixels, integer = pixel centre; u runs along columns, v along rows.

    kind        one of KINDS
    axis        coordinate that the frame encodes ('uv': crossed fringe or lattice)
    bit         of a binary code; 0 is the least significant
    inverted    255 - level
    period_px   of a fringe or of the lattice's lines
    shift       of a fringe, radians: level = 127.5 (1 + cos(2 pi coord / period_px - shift))
    width_px    lattice: width of a line; stripe: full width at half maximum of its raised-cosine profile
    at_u, at_v  centre of a stripe along its axis
    cell_px     width of a code's cells; cell k is [k cell_px, (k + 1) cell_px) - 0.5 + offset_px
    offset_px   origin of cells and lattice lines (lattice: centre of line 0; default half a period - 0.5)
    level       grey value of a uniform frame
    levels      grey value of each cell: any user-defined code (displayed rounded to integers)
    """

    kind: str
    axis: str | None = None
    bit: int | None = None
    inverted: bool = False
    period_px: float | None = None
    shift: float | None = None
    width_px: float | None = None
    at_u: float | None = None
    at_v: float | None = None
    cell_px: float = 1.0
    offset_px: float | None = None
    level: int | None = None
    levels: tuple[float, ...] | None = None

    def __post_init__(self) -> None:
        for field in fields(self):
            object.__setattr__(self, field.name, _plain(getattr(self, field.name), field.name))
        if self.kind not in KINDS:
            raise InputError(f"frame: kind is {self.kind!r}, known kinds are {', '.join(KINDS)}")
        for name in KINDS[self.kind]:
            if getattr(self, name) is None:
                raise InputError(f"frame: {name} is missing, kind {self.kind!r} needs it")
        if self.axis not in _AXES.get(self.kind, ("u", "v")):
            allowed = ", ".join(str(axis) for axis in _AXES.get(self.kind, ("u", "v")))
            raise InputError(f"frame: axis is {self.axis!r}, kind {self.kind!r} takes {allowed}")
        self._check_numbers()
        if self.kind == "stripe" and getattr(self, f"at_{self.axis}") is None:
            raise InputError(f"frame: at_{self.axis} is missing, a stripe on {self.axis!r} needs it")

    def _check_numbers(self) -> None:
        for name in ("period_px", "shift", "width_px", "at_u", "at_v", "cell_px", "offset_px"):
            value = getattr(self, name)
            if value is not None and not abs(value) <= _MOST:
                raise InputError(f"frame: {name} is {value}, must be finite and at most {_MOST:g}")
        for name in ("period_px", "width_px", "cell_px"):
            value = getattr(self, name)
            if value is not None and value <= 0:
                raise InputError(f"frame: {name} is {value}, must be above 0")
        for name in ("width_px", "cell_px"):
            value = getattr(self, name)
            if value is not None and value < _LEAST_WIDTH:
                raise InputError(f"frame: {name} is {value}, must be at least {_LEAST_WIDTH:g}")
        if self.period_px is not None and self.period_px < _LEAST_PERIOD:
            raise InputError(f"frame: period_px is {self.period_px}, must be at least {_LEAST_PERIOD:g}")
        if self.bit is not None and not 0 <= self.bit <= 30:
            raise InputError(f"frame: bit is {self.bit}, must be in 0..30")
        for level in (*(self.levels or ()), *(() if self.level is None else (self.level,))):
            if not 0 <= level <= 255:
                raise InputError(f"frame: level is {level}, must be in 0..255")
        if self.levels is not None and not self.levels:
            raise InputError("frame: levels is empty, must hold one grey value per cell")

    @property
    def combine(self) -> str:
        """How the tables of both axes make the image.

        'multiply': (tu[u] tv[v] + 127) // 255; 'mean': (tu[u] + tv[v] + 1) // 2.
        """
        return "mean" if self.kind == "crossed" else "multiply"

    def tables(self, rows: int, cols: int) -> tuple[Table, Table]:
        """Grey values along u (cols,) and along v (rows,)."""
        return frame_tables(self, rows, cols)

    def free_levels(self, coord: Levels) -> Levels:
        """Of kind "levels": grey values at pixels as described, neither rounded nor inverted; 0 beyond."""
        cell, values = _cell_of(self, coord), np.asarray(self.levels, np.float64)
        inside = (cell >= 0) & (cell < len(values))
        return np.where(inside, values[np.clip(cell, 0, len(values) - 1)], 0.0)

    def ideal_levels(self, coord: Levels, axis: str) -> Levels:
        """Grey values at any coordinates along an axis, as described, not rounded."""
        levels = _levels(self, coord, axis)
        return np.asarray(255.0 - levels if self.inverted else levels, np.float64)

    def to_dict(self) -> dict[str, Any]:
        """Plain TOML types; fields at their default are omitted."""
        plain: dict[str, Any] = {}
        for field in fields(self):
            value = getattr(self, field.name)
            if value is not None and value != field.default:
                plain[field.name] = list(value) if isinstance(value, tuple) else value
        return plain

    @classmethod
    def from_dict(cls, plain: Mapping[str, Any], where: str = "frame") -> Frame:
        """Inverse of to_dict; in place of `shift`, too, shift_deg (degrees) or shift_step (k of N, [k, N]).
        InputError names `where`, the field, its value and its limit."""
        known = {field.name: str(field.type) for field in fields(cls)}
        values: dict[str, Any] = {}
        for name, value in _in_radians(plain, where).items():
            if name == "exposure":
                raise InputError(
                    f"{where}: exposure is {value}, one alone is decoded: keep its frames, leave this out"
                )
            if name not in known:
                names = ", ".join([*known, *_SHIFTS])
                raise InputError(f"{where}: unknown field {name!r}, known are {names}")
            values[name] = _typed(value, known[name], f"{where}: {name}")
        if "kind" not in values:
            raise InputError(f"{where}: kind is missing")
        try:
            return cls(**values)
        except InputError as error:
            raise InputError(f"{where}: {error}") from error


_WHOLE, _TEXT = ("bit", "level"), ("kind", "axis")


def _plain(value: Any, name: str) -> Any:
    """The value of a field as a Python type, also from NumPy's numbers and arrays, else InputError."""
    if value is None or name in _TEXT:
        return value
    if name == "inverted":
        return bool(value)
    if name == "levels":
        return tuple(np.asarray(value).ravel().tolist())
    return whole(f"frame: {name}", value) if name in _WHOLE else real(f"frame: {name}", value)


#: A fringe's shift in other units.
_SHIFTS = ("shift_deg", "shift_step")


def _in_radians(plain: Mapping[str, Any], where: str) -> Mapping[str, Any]:
    """The fields with the shift in radians. InputError if it is given twice or is none."""
    given = [name for name in ("shift", *_SHIFTS) if name in plain]
    if not given or given == ["shift"]:
        return plain
    if len(given) > 1:
        raise InputError(f"{where}: {' and '.join(given)} are given, one of them says it all")
    name, value = given[0], plain[given[0]]
    if name == "shift_deg":
        shift = math.radians(real(f"{where}: shift_deg", value))
    else:
        if not isinstance(value, list | tuple) or len(value) != 2:
            raise InputError(f"{where}: shift_step is {value!r}, must be [k, N], such as [1, 4]")
        step, steps = (whole(f"{where}: shift_step", number) for number in value)
        if steps < 1:
            raise InputError(f"{where}: shift_step is {value!r}, N must be at least 1")
        shift = 2 * math.pi * step / steps
    return {key: each for key, each in plain.items() if key != name} | {"shift": shift}


def _typed(value: Any, wanted: str, where: str) -> Any:
    """Value as the annotated type of a Frame field, or InputError."""
    wanted = wanted.replace("<class '", "").replace("'>", "").removesuffix(" | None")
    is_int = isinstance(value, int) and not isinstance(value, bool)
    if wanted == "str" and isinstance(value, str):
        return value
    if wanted == "bool" and isinstance(value, bool):
        return value
    if wanted == "int" and is_int:
        return value
    if wanted == "float" and (is_int or isinstance(value, float)):
        return float(value)
    if wanted.startswith("tuple") and isinstance(value, list | tuple):
        return tuple(_typed(item, "int" if isinstance(item, int) else "float", where) for item in value)
    raise InputError(f"{where} is {value!r}, must be {'a list of numbers' if 'tuple' in wanted else wanted}")


def frame_tables(frame: Frame, rows: int, cols: int) -> tuple[Table, Table]:
    """Grey values along u (cols,) and along v (rows,); Frame.combine says how they make the image."""
    table_u, table_v = (
        _rounded(_levels(frame, np.arange(extent, dtype=np.float64), axis))
        for extent, axis in ((cols, "u"), (rows, "v"))
    )
    if frame.inverted:
        if frame.axis == "v":
            return table_u, 255 - table_v
        if frame.combine == "mean":
            return 255 - table_u, 255 - table_v
        return 255 - table_u, table_v
    return table_u, table_v


def lattice_lines(frame: Frame, extent: int) -> Levels:
    """Centres of a lattice's lines along an axis of `extent` pixels, pattern pixels (K,)."""
    period = frame.period_px or 1.0
    first = (period - 1) / 2 if frame.offset_px is None else frame.offset_px
    start = np.ceil((-0.5 - first) / period)
    stop = np.floor((extent - 0.5 - first) / period)
    return first + period * np.arange(start, stop + 1)


def _levels(frame: Frame, coord: Levels, axis: str) -> Levels:
    if frame.kind in ("white", "black", "uniform"):
        level = {"white": 255, "black": 0}.get(frame.kind, frame.level or 0)
        # one axis carries the level, the other stays at 255, so that the product is the level
        return np.full(coord.shape, level if axis == "u" else 255.0)
    if frame.axis is not None and axis not in frame.axis:
        return np.full(coord.shape, 255.0)
    if frame.kind in ("phase", "crossed"):
        return _fringe(frame, coord)
    if frame.kind == "stripe":
        return _stripe(frame, coord, axis)
    if frame.kind == "lattice":
        return _lattice(frame, coord)
    if frame.kind == "levels":
        return frame.free_levels(coord)
    words = code_words(frame.kind, np.maximum(_cell_of(frame, coord), 0))
    return np.asarray(255.0 * ((words >> (frame.bit or 0)) & 1), np.float64)


def _rounded(levels: Levels) -> Table:
    """Mid grey, 127.5, always rounds up: the cosine's rounding error would bias the phase."""
    return np.clip(np.floor(levels + (0.5 + _TIE)), 0, 255).astype(np.uint8)


def _fringe(frame: Frame, coord: Levels) -> Levels:
    angle = 2 * np.pi * coord / (frame.period_px or 1.0) - (frame.shift or 0.0)
    return 127.5 * (1 + np.cos(angle))


def _stripe(frame: Frame, coord: Levels, axis: str) -> Levels:
    """Raised cosine: of all profiles of that width the one whose sampled sum does not depend on position."""
    centre = (frame.at_u if axis == "u" else frame.at_v) or 0.0
    distance = np.abs(coord - centre) / (frame.width_px or 1.0)
    return np.where(distance < 1, 127.5 * (1 + np.cos(np.pi * distance)), 0.0)


def _lattice(frame: Frame, coord: Levels) -> Levels:
    """Dark lines on bright, their edges smoothed by a tent of two cells.

    Of all smoothings that narrow the tent is the first whose sampled lines keep their exact centroid: its
    transform and the slope of that vanish at the sampling frequency.
    """
    width = frame.width_px or 1.0
    covered = np.zeros_like(coord)
    for centre in lattice_lines(frame, len(coord)):
        covered += _tent_share(centre + width / 2 - coord) - _tent_share(centre - width / 2 - coord)
    return 255.0 * (1 - np.minimum(covered, 1.0))


def _tent_share(edge: Levels) -> Levels:
    """Share of the tent 1 - |x| that lies below `edge`."""
    inside = np.clip(edge, -1.0, 1.0)
    return np.where(inside < 0, 0.5 * (1 + inside) ** 2, 1 - 0.5 * (1 - inside) ** 2)


def _cell_of(frame: Frame, coord: Levels) -> NDArray[np.int64]:
    """Of binary codes and free grey values: the cell that contains a pixel's centre."""
    return np.floor((coord + 0.5 - (frame.offset_px or 0.0)) / frame.cell_px).astype(np.int64)
