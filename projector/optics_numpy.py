"""The virtual sensor's light in float64, the reference of the GLSL one: scene.trace and footprint kernels."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from optolever.arrays import Floats
from optolever.blocks import over_rows
from optolever.patterns import Sequence
from optolever.scene import Display, Scene, Surface, Trace, mean_beside, movement, scene_window, trace

from .footprint import look_up_one, look_up_two
from .groups import FrameGroup, frame_groups

__all__ = ["Footprints", "NumpyOptics", "footprints", "light_of"]

_BLOCK = 4096  # pixels at a time per thread


@dataclass(frozen=True, slots=True, eq=False)
class Footprints:
    """Where P pixels look: u, v (P,), mean over the light of the pixel, cells; light (P,) that the mirror
    passes on (0: no pattern there); boxes_u, boxes_v (P, 2): how far u and v move along a pixel's columns and
    along its rows, cells."""

    u: Floats
    v: Floats
    light: Floats
    boxes_u: Floats
    boxes_v: Floats

    def along(self, axis: str) -> Floats:
        """(P, 6): position along the axis and its boxes, then position across it and its boxes."""
        u = np.column_stack([self.u, self.boxes_u])
        v = np.column_stack([self.v, self.boxes_v])
        return np.ascontiguousarray(np.hstack([v, u] if axis == "v" else [u, v]))


def footprints(scene: Scene, surface: Surface, start: int, stop: int) -> Footprints:
    """Trace the pixels of rows start..stop, and the middles of their four edges."""
    rows, cols = stop - start, scene.camera.cols
    centre = trace(scene_window(scene, start, 0, rows, cols), surface)
    by_col = trace(scene_window(scene, start, -0.5, rows, cols + 1), surface)
    by_row = trace(scene_window(scene, start - 0.5, 0, rows + 1, cols), surface)
    lights = [_passed(scene, seen) for seen in (by_col, centre, by_row)]
    along = lights[0][:, :-1], lights[1], lights[0][:, 1:]
    down = lights[2][:-1], lights[1], lights[2][1:]
    means, spread = [], []
    for name in ("u", "v"):
        at = getattr(centre, name)
        edges_col, edges_row = getattr(by_col, name), getattr(by_row, name)
        ends = (edges_col[:, :-1], at, edges_col[:, 1:]), (edges_row[:-1], at, edges_row[1:])
        means.append((at + mean_beside(ends[0], along) + mean_beside(ends[1], down)).ravel())
        spread.append(np.column_stack([movement(*three).ravel() for three in ends]))
    light = np.where(centre.visible, lights[1], 0.0)
    return Footprints(means[0], means[1], light.ravel(), spread[0], spread[1])


def _passed(scene: Scene, seen: Trace) -> Floats:
    """Share of the light that the mirror passes on."""
    if scene.medium is None:
        return np.ones(seen.u.shape)
    return np.asarray(scene.medium.reflectance(np.abs(np.cos(seen.incidence))))


class NumpyOptics:
    """Light on the camera's pixels, relative to a fully lit, fully reflecting one."""

    def __init__(self, scene: Scene, groups: list[FrameGroup], surface: Surface) -> None:
        self._scene, self._groups, self._surface = scene, groups, surface

    def release(self) -> None:
        """No memory to free."""

    def render(self, start: int, stop: int) -> list[tuple[int, NDArray[np.float32]]]:
        """(frame index, light (stop - start, W) float32) of all frames."""
        seen = footprints(self._scene, self._surface, start, stop)
        found = []
        for group in self._groups:
            light = look_up(seen, group, self._scene.pattern.blur_px)
            light = light.reshape(stop - start, -1, len(group.indices))
            found += [(index, light[..., at]) for at, index in enumerate(group.indices)]
        return found


def light_of(
    seen: Footprints, sequence: Sequence, display: Display | None, blur: float
) -> NDArray[np.float32]:
    """Light (N, P) of a sequence's frames on the pixels, relative to one fully lit, fully reflecting; blur:
    rms, cells."""
    light = np.empty((len(sequence), seen.light.size), np.float32)
    for group in frame_groups(sequence, display):
        light[list(group.indices)] = look_up(seen, group, blur).T
    return light


def look_up(seen: Footprints, group: FrameGroup, blur: float) -> NDArray[np.float32]:
    """Light of the group's frames on the pixels: (P, n)."""
    look = seen.along(group.axis)
    out = np.empty((seen.light.size, len(group.indices)), np.float32)
    over_rows(_kernel(look, seen.light, group, blur, out), seen.light.size, _BLOCK)
    return out


def _kernel(
    look: Floats, light: Floats, group: FrameGroup, blur: float, out: NDArray[np.float32]
) -> Callable[[int, int], None]:
    table = np.ascontiguousarray(group.light)
    levels = (np.ascontiguousarray(group.levels[0]), np.ascontiguousarray(group.levels[1]))

    def work(start: int, stop: int) -> None:
        rows = slice(start, stop)
        if group.axis == "uv":
            look_up_two(look[rows], light[rows], blur, levels, group.mean, group.response, out[rows])
        else:
            look_up_one(look[rows], light[rows], blur, table, group.across, out[rows])

    return work
