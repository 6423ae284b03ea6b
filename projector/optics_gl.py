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
from .shaders import ShaderSource, build_source, compile_program
from .surface_gl import LoadedSurface, load_surface

__all__ = ["GLOptics", "look_source", "trace_source"]

_NEAR = 2e-6  # of the mirror's length: see `near` in trace.glsl
_MARCH = 4096  # shortest marching steps that cross the mirror
_BELOW = 1e-6  # of the mirror's length: distance from the surface below float32's resolution
_BEYOND = 0.01  # of the mirror's size: how far outside of it rays of the outermost pixels' edges may end

_Target = tuple[moderngl.Framebuffer, tuple[moderngl.Texture, ...]]


def trace_source(scene: Scene, surface: LoadedSurface, *, edges: bool) -> ShaderSource:
    """The source that traces a scene: only what scene and surface have. edges: only where they see."""
    flags = {
        "PARALLEL": parallel_rays(scene) is not None,
        "MEDIUM": scene.medium is not None,
        "SEEN": not edges,
        "MARCH": surface.steepest > 0.0,
    }
    return build_source("trace.glsl", flags | surface.flags)


def look_source(scene: Scene, group: FrameGroup, quads: int) -> ShaderSource:
    """The source that looks up 4 * quads frames of a group."""
    blurred = scene.pattern.blur_px > 0.0
    flags = {
        "BLUR": blurred,
        "BOTH": group.axis == "uv",
        "MEAN": group.mean,
        "ALONG_U": group.axis == "u",
    }
    floor = {"BLUR_FLOOR": BLUR_FLOOR, "REACH": REACH} if blurred else {"SHARP_FLOOR": SHARP_FLOOR}
    askew = {"ASKEW": ASKEW, "PARTS": PARTS} if group.axis == "uv" else {}
    return build_source("look.glsl", flags, {"QUADS": quads, **floor, **askew})


@dataclass(frozen=True, slots=True)
class _Program:
    """A compiled fragment shader, ready to cover a target. Sensors share it: uniforms are set per drawing."""

    program: moderngl.Program
    vertices: moderngl.VertexArray

    def set(self, **values: Any) -> None:
        """Set those of the uniforms that the driver kept."""
        for name, value in values.items():
            if name in self.program:
                self.program[name] = value

    def draw(
        self,
        framebuffer: moderngl.Framebuffer,
        shape: tuple[int, int],
        textures: Mapping[str, moderngl.Texture],
    ) -> None:
        """Cover the first shape (rows, cols) pixels of the target."""
        framebuffer.use()
        framebuffer.viewport = (0, 0, shape[1], shape[0])
        for unit, (name, texture) in enumerate(textures.items()):
            texture.use(unit)
            self.program[name] = unit
        self.vertices.render(moderngl.TRIANGLES, vertices=3)

    def release(self) -> None:
        self.vertices.release()
        self.program.release()


def _program(source: ShaderSource) -> _Program:
    """A source's program, compiled once in a context: drivers take longer for that than for the drawing."""

    def make(ctx: moderngl.Context) -> _Program:
        program = compile_program(ctx, source)
        return _Program(program, ctx.vertex_array(program, []))

    return keep(source.text, make)


@dataclass(frozen=True, slots=True)
class _Look:
    """A group's program and its tables on the GPU, for `quads` attachments of four frames each."""

    group: FrameGroup
    quads: int
    program: _Program
    textures: dict[str, moderngl.Texture]


class GLOptics:
    """Light on the camera's pixels, 1 where fully lit and reflected, at most `strip` rows at a time.

    Use it in the thread that made it, and release it.
    """

    def __init__(self, scene: Scene, groups: list[FrameGroup], strip: int) -> None:
        self._scene = scene
        self._ctx = context()
        self._parallel = parallel_rays(scene)
        self._most = 4 * context_info().max_attachments
        self._groups = [part for group in groups for part in group.split(self._most)]
        self._looks: dict[int | None, list[_Look]] = {}
        rows, cols = strip, scene.camera.cols
        quads = max(_quads(group) for group in self._groups)
        with checked(self._ctx):
            self._seen = self._target((cols, rows), 1)
            self._edges_col = self._target((cols + 1, rows), 1)
            self._edges_row = self._target((cols, rows + 1), 1)
            self._light = [self._target((cols, rows), count + 1) for count in range(quads)]

    def load(self, surface: Surface) -> LoadedSurface:
        """Bring a surface to the GPU."""
        with checked(self._ctx):
            return load_surface(self._ctx, self._scene, surface)

    def unload(self, surface: LoadedSurface) -> None:
        """Free a surface."""
        free(self._ctx, surface)

    def release(self) -> None:
        """Free its GPU memory; the context stays, and its programs with it."""
        tables = [
            texture for looks in self._looks.values() for look in looks for texture in look.textures.values()
        ]
        targets = (self._seen, self._edges_col, self._edges_row, *self._light)
        attached = [item for framebuffer, textures in targets for item in (framebuffer, *textures)]
        free(self._ctx, *tables, *attached)

    def render(
        self, surface: LoadedSurface, start: int, stop: int, frame: int | None = None
    ) -> list[tuple[int, NDArray[np.float32]]]:
        """(frame index, light (stop - start, W) float32) of all frames, or of one."""
        rows, cols = stop - start, self._scene.camera.cols
        found = []
        with checked(self._ctx):
            self._trace(surface, start, rows)
            for look in self._looks_of(frame):
                framebuffer = self._light[look.quads - 1][0]
                self._look_up(look, framebuffer, rows)
                for n in range(look.quads):
                    four = np.empty((rows, cols, 4), np.float32)
                    framebuffer.read_into(four, (0, 0, cols, rows), 4, attachment=n, dtype="f4")
                    frames = look.group.indices[4 * n : 4 * n + 4]
                    found += [(index, four[..., c]) for c, index in enumerate(frames)]
        return found

    def seen(self, surface: LoadedSurface, start: int, stop: int) -> NDArray[np.float32]:
        """(stop - start, W, 4): u, v, light that is passed on (0 without a view), cosine of incidence."""
        rows, cols = stop - start, self._scene.camera.cols
        out = np.empty((rows, cols, 4), np.float32)
        with checked(self._ctx):
            self._trace(surface, start, rows)
            self._seen[0].read_into(out, (0, 0, cols, rows), 4, dtype="f4")
        return out

    def _trace(self, surface: LoadedSurface, start: int, rows: int) -> None:
        """Trace the pixels' centres, and the middles of their edges, into the targets."""
        cols = self._scene.camera.cols
        self._draw_trace(self._seen, surface, False, (start, 0.0), (rows, cols))
        self._draw_trace(self._edges_col, surface, True, (start, -0.5), (rows, cols + 1))
        self._draw_trace(self._edges_row, surface, True, (start - 0.5, 0.0), (rows + 1, cols))

    def _draw_trace(
        self,
        target: _Target,
        surface: LoadedSurface,
        edges: bool,
        first: tuple[float, float],
        shape: tuple[int, int],
    ) -> None:
        program = _program(trace_source(self._scene, surface, edges=edges))
        program.set(first=first[::-1], **self._uniforms(surface, _BEYOND if edges else 0.0))
        rays = {} if self._parallel is not None else self._ray_textures(first, shape)
        grid = {} if surface.texture is None else {"coefficients": surface.texture}
        program.draw(target[0], shape, grid | rays)
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

    def _look_up(self, look: _Look, framebuffer: moderngl.Framebuffer, rows: int) -> None:
        seen = {"seen": self._seen, "edges_col": self._edges_col, "edges_row": self._edges_row}
        textures = {name: target[1][0] for name, target in seen.items()} | look.textures
        pattern = self._scene.pattern
        look.program.set(cells=(pattern.cols, pattern.rows), blur=pattern.blur_px)
        look.program.draw(framebuffer, (rows, self._scene.camera.cols), textures)

    def _looks_of(self, frame: int | None) -> list[_Look]:
        """Programs and tables of all frames (None) or of one, made at the first call."""
        if frame not in self._looks:
            groups = self._groups
            if frame is not None:
                groups = [group.only(frame) for group in groups if frame in group.indices]
            self._looks[frame] = [self._make_look(group) for group in groups]
        return self._looks[frame]

    def _make_look(self, group: FrameGroup) -> _Look:
        quads = _quads(group)
        program = _program(look_source(self._scene, group, quads))
        textures = {}
        if group.axis == "uv":
            textures["table_u"], textures["table_v"] = (
                _texture(self._ctx, _in_quads(levels), "u1") for levels in group.levels
            )
            textures["response"] = _texture(self._ctx, group.response[None, :, None], "f4")
        else:
            textures["table"] = _texture(self._ctx, _in_quads(group.light), "f4")
        return _Look(group, quads, program, textures)

    def _uniforms(self, surface: LoadedSurface, beyond: float) -> dict[str, Any]:
        """Uniforms of trace.glsl; `beyond`: margin around the mirror that it traces, relative to its size."""
        scene, pattern = self._scene, self._scene.pattern
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


def _quads(group: FrameGroup) -> int:
    return -(-len(group.indices) // 4)


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
