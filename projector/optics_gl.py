"""The virtual sensor's light in GLSL: trace.glsl follows the rays, look.glsl looks up the frames."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import moderngl
import numpy as np
from numpy.typing import NDArray

from optolever.scene import Scene, Surface

from .context import checked, context, context_info, free, keep
from .footprint import ASKEW, BLUR_FLOOR, PARTS, REACH, SHARP_FLOOR
from .groups import FrameGroup
from .rays import parallel_rays, resting_rays
from .shaders import compile_program, source
from .surface_gl import load_surface

__all__ = ["GLOptics"]

_NEAR = 2e-6  # of the mirror's length: see `near` in trace.glsl
_MARCH = 4096  # shortest marching steps that cross the mirror
_BELOW = 1e-6  # of the mirror's length: distance from the surface below float32's resolution
_BEYOND = 0.01  # of the mirror's size: how far outside of it rays of the outermost pixels' edges may end

_Target = tuple[moderngl.Framebuffer, tuple[moderngl.Texture, ...]]


@dataclass(frozen=True, slots=True)
class _Program:
    """A compiled fragment shader, ready to cover a target; captures share it."""

    program: moderngl.Program
    vertices: moderngl.VertexArray

    def draw(
        self,
        framebuffer: moderngl.Framebuffer,
        shape: tuple[int, int],
        textures: Mapping[str, moderngl.Texture],
        uniforms: Mapping[str, Any],
    ) -> None:
        """Cover `shape` (rows, cols) of the target; set the uniforms that the driver kept."""
        framebuffer.use()
        framebuffer.viewport = (0, 0, shape[1], shape[0])
        for name, value in uniforms.items():
            if name in self.program:
                self.program[name] = value
        for unit, (name, texture) in enumerate(textures.items()):
            texture.use(unit)
            self.program[name] = unit
        self.vertices.render(moderngl.TRIANGLES, vertices=3)


def _program(text: str) -> _Program:
    """A source's program, compiled once in a context: drivers take longer for that than for the drawing."""

    def make(ctx: moderngl.Context) -> _Program:
        program = compile_program(ctx, text)
        return _Program(program, ctx.vertex_array(program, []))

    return keep(text, make)


@dataclass(frozen=True, slots=True)
class _Look:
    """A group's program and its tables on the GPU, for `quads` attachments of four frames each."""

    group: FrameGroup
    quads: int
    program: _Program
    textures: dict[str, moderngl.Texture]


class GLOptics:
    """Light on the camera's pixels, 1 where fully lit and reflected, at most `strip` rows at a time.

    Use it in the thread that made it, and release it. seen: target of `trace`: u, v, light that is
    passed on (0 without a view), cosine of incidence.
    """

    def __init__(self, scene: Scene, groups: list[FrameGroup], strip: int, surface: Surface) -> None:
        self._scene, self._parallel, self._ctx = scene, parallel_rays(scene), context()
        most = 4 * context_info().max_attachments
        rows, cols = strip, scene.camera.cols
        with checked(self._ctx):
            self._surface = load_surface(self._ctx, scene, surface)
            self._looks = [self._look(part) for group in groups for part in group.split(most)]
            self.seen = self._target((cols, rows), 1)
            self._edges_col = self._target((cols + 1, rows), 1)
            self._edges_row = self._target((cols, rows + 1), 1)
            self._light = {
                quads: self._target((cols, rows), quads) for quads in {one.quads for one in self._looks}
            }

    def release(self) -> None:
        """Free its GPU memory; the context stays, and its programs with it."""
        tables = [texture for look in self._looks for texture in look.textures.values()]
        targets = (self.seen, self._edges_col, self._edges_row, *self._light.values())
        attached = [item for framebuffer, textures in targets for item in (framebuffer, *textures)]
        grid = [] if self._surface.texture is None else [self._surface.texture]
        free(self._ctx, *tables, *attached, *grid)

    def render(self, start: int, stop: int) -> list[tuple[int, NDArray[np.float32]]]:
        """(frame index, light (stop - start, W) float32) of all frames."""
        rows, (cols, cells) = stop - start, (self._scene.camera.cols, self._scene.pattern)
        found = []
        self.trace(start, rows)
        seen = {"seen": self.seen, "edges_col": self._edges_col, "edges_row": self._edges_row}
        places = {name: target[1][0] for name, target in seen.items()}
        uniforms = {"cells": (cells.cols, cells.rows), "blur": cells.blur_px}
        with checked(self._ctx):
            for look in self._looks:
                framebuffer = self._light[look.quads][0]
                look.program.draw(framebuffer, (rows, cols), places | look.textures, uniforms)
                for n in range(look.quads):
                    four = np.empty((rows, cols, 4), np.float32)
                    framebuffer.read_into(four, (0, 0, cols, rows), 4, attachment=n, dtype="f4")
                    frames = look.group.indices[4 * n : 4 * n + 4]
                    found += [(index, four[..., c]) for c, index in enumerate(frames)]
        return found

    def trace(self, start: int, rows: int) -> None:
        """Trace the pixels' centres, and the middles of their edges, into the targets."""
        cols = self._scene.camera.cols
        with checked(self._ctx):
            self._draw_trace(self.seen, False, (start, 0.0), (rows, cols))
            self._draw_trace(self._edges_col, True, (start, -0.5), (rows, cols + 1))
            self._draw_trace(self._edges_row, True, (start - 0.5, 0.0), (rows + 1, cols))

    def _draw_trace(
        self, target: _Target, edges: bool, first: tuple[float, float], shape: tuple[int, int]
    ) -> None:
        """edges: only where they see."""
        surface = self._surface
        flags = {
            "PARALLEL": self._parallel is not None,
            "MEDIUM": self._scene.medium is not None,
            "SEEN": not edges,
            "MARCH": surface.steepest > 0.0,
        }
        program = _program(source("trace.glsl", flags | surface.flags))
        rays = {} if self._parallel is not None else self._ray_textures(first, shape)
        grid = {} if surface.texture is None else {"coefficients": surface.texture}
        uniforms = {"first": first[::-1], **self._uniforms(_BEYOND if edges else 0.0)}
        program.draw(target[0], shape, grid | rays, uniforms)
        for texture in rays.values():
            texture.release()

    def _ray_textures(
        self, first: tuple[float, float], shape: tuple[int, int]
    ) -> dict[str, moderngl.Texture]:
        row = first[0] + np.arange(shape[0], dtype=np.float64)[:, None]
        rays = resting_rays(self._scene, row, first[1] + np.arange(shape[1], dtype=np.float64))
        end = rays.end[..., :2].astype(np.float32)
        vectors = {
            "feet": (rays.foot,),
            "directions": (rays.directions, rays.end[..., 2:]),
            "ends": (end, rays.end[..., :2] - end),
        }
        return {
            name: _texture(self._ctx, np.concatenate(parts, axis=-1, dtype=np.float32), "f4")
            for name, parts in vectors.items()
        }

    def _look(self, group: FrameGroup) -> _Look:
        """Program and tables of a group."""
        quads, blurred = -(-len(group.indices) // 4), self._scene.pattern.blur_px > 0.0
        flags = {
            "BLUR": blurred,
            "BOTH": group.axis == "uv",
            "MEAN": group.mean,
            "ALONG_U": group.axis == "u",
        }
        floors = {"BLUR_FLOOR": BLUR_FLOOR, "SHARP_FLOOR": SHARP_FLOOR, "REACH": REACH, "ASKEW": ASKEW}
        program = _program(source("look.glsl", flags, QUADS=quads, PARTS=PARTS, **floors))
        if group.axis != "uv":
            return _Look(group, quads, program, {"table": _texture(self._ctx, _in_quads(group.light), "f4")})
        textures = {
            name: _texture(self._ctx, _in_quads(levels), "u1")
            for name, levels in zip(("table_u", "table_v"), group.levels, strict=True)
        }
        textures["response"] = _texture(self._ctx, group.response[None, :, None], "f4")
        return _Look(group, quads, program, textures)

    def _uniforms(self, beyond: float) -> dict[str, Any]:
        """Uniforms of trace.glsl; `beyond`: margin around the mirror that it traces, relative to its size."""
        scene, pattern, surface = self._scene, self._scene.pattern, self._surface
        length, width = scene.mirror.length, scene.mirror.width
        values: dict[str, Any] = {
            "lowest": (-beyond * length, -beyond * width, surface.lowest),
            "highest": ((1 + beyond) * length, (1 + beyond) * width, surface.highest),
            "near": _NEAR * length,
            "u_axis": tuple(pattern.u_axis / pattern.pitch),
            "v_axis": tuple(pattern.v_axis / (pattern.pitch * pattern.aspect)),
            "facing": tuple(pattern.normal),
            "steepest": surface.steepest,
            "shortest": float(np.hypot(length, width)) / _MARCH,
            "below": _BELOW * length,
            "cells": (pattern.cols, pattern.rows),
            **surface.uniforms,
        }
        if scene.medium is not None:
            values["index_ratio"] = scene.medium.index / scene.medium.outside
        if self._parallel is not None:
            values["direction"] = tuple(self._parallel.direction)
            values["foot"] = [tuple(term) for term in self._parallel.foot]
            values["end"] = [tuple(term) for term in self._parallel.end]
        return values

    def _target(self, size: tuple[int, int], count: int) -> _Target:
        textures = tuple(self._ctx.texture(size, 4, dtype="f4") for _ in range(count))
        for texture in textures:
            texture.filter = (moderngl.NEAREST, moderngl.NEAREST)
        return self._ctx.framebuffer(list(textures)), textures


def _in_quads(table: NDArray[Any]) -> NDArray[Any]:
    """(cells, n) -> (n / 4, cells, 4), zeros where n is no multiple of 4."""
    cells, count = table.shape
    quads = -(-count // 4)
    padded = np.zeros((cells, 4 * quads), table.dtype)
    padded[:, :count] = table
    return np.ascontiguousarray(padded.reshape(cells, quads, 4).transpose(1, 0, 2))


def _texture(ctx: moderngl.Context, values: NDArray[Any], kind: str) -> moderngl.Texture:
    """A texture from (rows, cols, components)."""
    rows, cols, components = values.shape
    texture = ctx.texture((cols, rows), components, values.tobytes(), alignment=1, dtype=kind)
    texture.filter = (moderngl.NEAREST, moderngl.NEAREST)
    return texture
