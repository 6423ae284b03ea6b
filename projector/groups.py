"""Frames that are looked up together: they vary along the same axis of the pattern, or along both."""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from optolever.patterns import Sequence
from optolever.scene import Display

__all__ = ["FrameGroup", "combined", "frame_groups", "varying_axis"]


@dataclass(frozen=True, slots=True, eq=False)
class FrameGroup:
    """Frames `indices` of a sequence, and the light of their cells.

    axis: 'u' or 'v' where frames vary along this axis at most: `light` (cells, n) float32 is emitted
    light, 0..1, and `across` counts the cells of the other axis. 'uv' otherwise: levels (cols, n) and (rows,
    n) uint8, combined by their product or, if `mean`, their mean, and `response` (256,) float32, the light
    of each level.
    """

    indices: tuple[int, ...]
    axis: str
    light: NDArray[np.float32]
    across: int
    levels: tuple[NDArray[np.uint8], NDArray[np.uint8]]
    mean: bool
    response: NDArray[np.float32]

    def split(self, most: int) -> Iterator["FrameGroup"]:
        """The same frames in groups of at most `most`."""
        for start in range(0, len(self.indices), most):
            part = slice(start, start + most)
            levels = (self.levels[0][:, part], self.levels[1][:, part])
            yield replace(self, indices=self.indices[part], light=self.light[:, part], levels=levels)


def frame_groups(sequence: Sequence, display: Display | None) -> list[FrameGroup]:
    """The groups of a sequence on a display (None: light proportional to level)."""
    shown = Display() if display is None else display
    response = shown.light(np.arange(256, dtype=np.float64)).astype(np.float32)
    table_u, table_v = sequence.tables()
    kinds: dict[tuple[str, bool], list[int]] = {}
    for index, frame in enumerate(sequence.frames):
        axis = varying_axis(table_u[index], table_v[index])
        kinds.setdefault((axis, axis == "uv" and frame.combine == "mean"), []).append(index)
    groups = []
    for (axis, mean), indices in kinds.items():
        levels = (np.ascontiguousarray(table_u[indices].T), np.ascontiguousarray(table_v[indices].T))
        light = np.zeros((0, len(indices)), np.float32)
        if axis != "uv":
            along, across = levels if axis == "u" else levels[::-1]
            means = np.array([sequence.frames[index].combine == "mean" for index in indices])
            light = response[combined(along, across[:1], means)]
        cells = sequence.rows if axis == "u" else sequence.cols
        groups.append(FrameGroup(tuple(indices), axis, light, cells, levels, mean, response))
    return groups


def combined(a: NDArray[np.uint8], b: NDArray[np.uint8], mean: NDArray[np.bool_]) -> NDArray[np.uint8]:
    """Levels that the display shows for two tables' levels, rounded as Sequence.render_frame rounds."""
    first, second = a.astype(np.int64), b.astype(np.int64)
    return np.where(mean, (first + second + 1) // 2, (first * second + 127) // 255).astype(np.uint8)


def varying_axis(along_u: NDArray[np.uint8], along_v: NDArray[np.uint8]) -> str:
    """The axis along which a frame of these tables varies: 'u' (also where along none), 'v' or 'uv'."""
    if (along_v == along_v[0]).all():
        return "u"
    return "v" if (along_u == along_u[0]).all() else "uv"
