"""What a frame shows: one 1-D table of grey values per axis, made here and nowhere else."""

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from .codes import code_words

if TYPE_CHECKING:
    from .frame import Frame

__all__ = ["frame_tables", "lattice_lines"]

Table = NDArray[np.uint8]
Levels = NDArray[np.float64]


def frame_tables(frame: "Frame", rows: int, cols: int) -> tuple[Table, Table]:
    """Grey values along u (cols,) and along v (rows,); Frame.combine says how they make the image."""
    table_u = _table(frame, cols, "u")
    table_v = _table(frame, rows, "v")
    if frame.inverted:
        if frame.axis == "v":
            return table_u, 255 - table_v
        if frame.combine == "mean":
            return 255 - table_u, 255 - table_v
        return 255 - table_u, table_v
    return table_u, table_v


def lattice_lines(frame: "Frame", extent: int) -> Levels:
    """Centres of a lattice's lines along an axis of `extent` pixels, pattern pixels (K,)."""
    period = frame.period_px or 1.0
    first = (period - 1) / 2 if frame.offset_px is None else frame.offset_px
    start = np.ceil((-0.5 - first) / period)
    stop = np.floor((extent - 0.5 - first) / period)
    return first + period * np.arange(start, stop + 1)


def _table(frame: "Frame", extent: int, axis: str) -> Table:
    coord = np.arange(extent, dtype=np.float64)
    if frame.kind in ("white", "black", "uniform"):
        level = {"white": 255, "black": 0}.get(frame.kind, frame.level or 0)
        # one axis carries the level, the other stays at 255, so that the product is the level
        return np.full(extent, level if axis == "u" else 255, np.uint8)
    if frame.axis is not None and axis not in frame.axis:
        return np.full(extent, 255, np.uint8)
    if frame.kind in ("phase", "crossed"):
        return _rounded(_fringe(frame, coord))
    if frame.kind == "stripe":
        return _rounded(_stripe(frame, coord, axis))
    if frame.kind == "lattice":
        return _rounded(_lattice(frame, coord))
    return _cells(frame, coord)


def _rounded(levels: Levels) -> Table:
    return np.clip(np.floor(levels + 0.5), 0, 255).astype(np.uint8)


def _fringe(frame: "Frame", coord: Levels) -> Levels:
    angle = 2 * np.pi * coord / (frame.period_px or 1.0) - (frame.shift or 0.0)
    return 127.5 * (1 + np.cos(angle))


def _stripe(frame: "Frame", coord: Levels, axis: str) -> Levels:
    """Raised cosine: of all profiles of that width the one whose sampled sum does not depend on position."""
    centre = (frame.at_u if axis == "u" else frame.at_v) or 0.0
    distance = np.abs(coord - centre) / (frame.width_px or 1.0)
    return np.where(distance < 1, 127.5 * (1 + np.cos(np.pi * distance)), 0.0)


def _lattice(frame: "Frame", coord: Levels) -> Levels:
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


def _cells(frame: "Frame", coord: Levels) -> Table:
    """Binary codes and free grey values: the cell of a pixel is the one that holds its centre."""
    cell = np.floor((coord + 0.5 - (frame.offset_px or 0.0)) / frame.cell_px).astype(np.int64)
    if frame.kind == "levels":
        values = np.asarray(frame.levels, np.uint8)
        return np.where(
            (cell >= 0) & (cell < len(values)), values[np.clip(cell, 0, len(values) - 1)], 0
        ).astype(np.uint8)
    words = code_words(frame.kind, np.maximum(cell, 0))
    return (255 * ((words >> (frame.bit or 0)) & 1)).astype(np.uint8)
