"""Draws the frames of a Sequence with OpenGL, bit-equal to Sequence.render()."""

import moderngl
import numpy as np
from numpy.typing import NDArray

from optolever.patterns import Sequence

from .context import free
from .groups import combined, varying_axis
from .shaders import compile_program, source

__all__ = ["FramePainter"]


class FramePainter:
    """A sequence's level tables on the GPU, and the programs that draw one frame into any framebuffer.

    A frame that varies along one axis needs one table only: as displayed, with the other axis' level.
    """

    def __init__(self, ctx: moderngl.Context, sequence: Sequence) -> None:
        table_u, table_v = sequence.tables()
        self._ctx = ctx
        self._size = sequence.cols, sequence.rows
        self._means = np.array([frame.combine == "mean" for frame in sequence.frames])
        self._axes = [varying_axis(u, v) for u, v in zip(table_u, table_v, strict=True)]
        means = self._means[:, None]
        self._textures = {
            "table_u": _table(ctx, table_u),
            "table_v": _table(ctx, table_v),
            "u": _table(ctx, combined(table_u, table_v[:, :1], means)),
            "v": _table(ctx, combined(table_u[:, :1], table_v, means)),
        }
        self._programs = {axis: self._program(axis, sequence) for axis in sorted(set(self._axes))}
        self._vertices = {axis: ctx.vertex_array(program, []) for axis, program in self._programs.items()}

    def draw(self, index: int, target: moderngl.Framebuffer, height: int) -> None:
        """Draw frame `index` into the upper left corner of a target of that height, black around it."""
        axis = self._axes[index]
        program = self._programs[axis]
        target.use()
        target.clear()
        target.viewport = (0, height - self._size[1], *self._size)
        for unit, name in enumerate(("table_u", "table_v") if axis == "uv" else (axis,)):
            self._textures[name].use(unit)
        program["frame"] = index
        if axis != "u":
            program["top"] = height - 1
        if axis == "uv":
            program["mean"] = bool(self._means[index])
        self._vertices[axis].render(moderngl.TRIANGLES, vertices=3)

    def release(self) -> None:
        """Free its GPU memory."""
        free(self._ctx, *self._vertices.values(), *self._programs.values(), *self._textures.values())

    def _program(self, axis: str, sequence: Sequence) -> moderngl.Program:
        flags = {"BOTH": axis == "uv", "ALONG_U": axis == "u"}
        program = compile_program(self._ctx, source("pattern.glsl", flags))
        for unit, name in enumerate(("table_u", "table_v") if axis == "uv" else ("table",)):
            program[name] = unit
        return program


def _table(ctx: moderngl.Context, table: NDArray[np.uint8]) -> moderngl.Texture:
    count, length = table.shape
    texture = ctx.texture((length, count), 1, np.ascontiguousarray(table).tobytes(), alignment=1, dtype="u1")
    texture.filter = (moderngl.NEAREST, moderngl.NEAREST)
    return texture
