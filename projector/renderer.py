"""Draws the frames of a Sequence with OpenGL, bit-equal to Sequence.render()."""

from typing import Self

import moderngl
import numpy as np
from numpy.typing import NDArray

from optolever.patterns import Sequence

from .context import checked, context, free
from .groups import combined, varying_axis
from .shaders import compile_program, source

__all__ = ["PatternRenderer", "PicturePainter"]


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

    def draw(self, index: int, target: moderngl.Framebuffer, *, top: int = 0) -> None:
        """Draw frame `index`.

        top: 0 puts image row 0 at the target's first row (offscreen); the target's height puts it on top, and
        the area around the frame is black (a window).
        """
        axis = self._axes[index]
        program = self._programs[axis]
        target.use()
        if top:
            target.clear()
        target.viewport = (0, top - self._size[1] if top else 0, *self._size)
        for unit, name in enumerate(("table_u", "table_v") if axis == "uv" else (axis,)):
            self._textures[name].use(unit)
        program["frame"] = index
        if axis != "u":
            program["top"] = top
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


class PicturePainter:
    """Draws what a display shows, picture by picture: frames, or of a sequence in colour its exposures."""

    def __init__(self, ctx: moderngl.Context, sequence: Sequence) -> None:
        shown = [sequence] if sequence.packing is None else [sequence.channel(k) for k in range(3)]
        self._channels = [FramePainter(ctx, channel) for channel in shown]

    def draw(self, index: int, target: moderngl.Framebuffer, *, top: int = 0) -> None:
        """See FramePainter.draw."""
        everything = (True,) * 4
        masks = (
            [everything] if len(self._channels) == 1 else [(k == 0, k == 1, k == 2, True) for k in range(3)]
        )
        for painter, mask in zip(self._channels, masks, strict=True):
            target.color_mask = mask
            painter.draw(index, target, top=top)
        target.color_mask = everything


class PatternRenderer:
    """Offscreen frames of a sequence: `frame(i)` is the same array as `sequence.render_frame(i)`.

    A context manager; use it in the thread that made it.
    """

    def __init__(self, sequence: Sequence, ctx: moderngl.Context | None = None) -> None:
        self._ctx = context() if ctx is None else ctx
        self._shape = sequence.rows, sequence.cols
        self._count = len(sequence)
        with checked(self._ctx):
            self._painter = FramePainter(self._ctx, sequence)
            self._target = self._ctx.texture((sequence.cols, sequence.rows), 1, dtype="f1")
            self._framebuffer = self._ctx.framebuffer([self._target])

    def __len__(self) -> int:
        return self._count

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.release()

    def draw(self, index: int) -> None:
        """Draw frame `index` and leave it on the GPU."""
        self._painter.draw(index, self._framebuffer)

    def frame(self, index: int, out: NDArray[np.uint8] | None = None) -> NDArray[np.uint8]:
        """Draw frame `index` and read it back: (rows, cols) uint8, into `out` where given."""
        image = np.empty(self._shape, np.uint8) if out is None else out
        with checked(self._ctx):
            self.draw(index)
            self._framebuffer.read_into(image, components=1, alignment=1)
        return image

    def finish(self) -> None:
        """Wait until the GPU has drawn everything."""
        self._ctx.finish()

    def release(self) -> None:
        """Free its GPU memory; the context stays."""
        free(self._ctx, self._framebuffer, self._target, self._painter)


def _table(ctx: moderngl.Context, table: NDArray[np.uint8]) -> moderngl.Texture:
    count, length = table.shape
    texture = ctx.texture((length, count), 1, np.ascontiguousarray(table).tobytes(), alignment=1, dtype="u1")
    texture.filter = (moderngl.NEAREST, moderngl.NEAREST)
    return texture
