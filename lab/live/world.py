"""An independent renderer of small rigs: exact rays through a dented mirror, averaged over a camera pixel's
area.

Its intersection, reflection and look-up are its own; only the numbers of a rig (camera grid, pattern pose,
index) are read from a scene of a telecentric camera. A dent is a row (kind, x, y, size, peak): kind 0 a
Gaussian of that sigma; 1 a ball's contact of that radius on a half-space (Hertz), 2 a flat punch's with a
sharp rim (Sneddon), 3 a ball's on a layer 2.5 radii thick, bonded to a base (`_on_layer`). All fade to zero
over the outer tenth before x = L0, except in a world that is elastic (`fading`)."""

import math
from dataclasses import dataclass, replace
from functools import cache, lru_cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import gaussian_filter

from optolever.arrays import Floats
from optolever.blocks import over_rows
from optolever.kernels import exact, inlined
from optolever.patterns import Sequence
from optolever.scene import Scene

from ..figures.pressed import on_layer

GAUSS, BALL, PUNCH, LAYERED = 0, 1, 2, 3
_THICK = 2.5  # radii of a contact: the layer
_NEAREST, _STEP = 14.0, 0.01  # radii: end and step of the table of its deflection
_FINE = 8  # parts of a cell in which the blurred pattern is tabled


@dataclass(frozen=True)
class World:
    """camera (4, 3): origin, steps along columns and rows, direction; plane (3, 3): origin, steps of u and v;
    size: length and width of the mirror; index: of the medium, 0: an ideal mirror; blur: cells; fading: dents
    end at the camera's edge."""

    shape: tuple[int, int]
    camera: Floats
    plane: Floats
    size: Floats
    index: float
    blur: float
    fading: bool = True

    def moved(self, along: float = 0.0, down: float = 0.0, roll: float = 0.0) -> "World":
        """With the camera moved by so many pixels along columns and rows of its image, and rolled about its
        middle, rad."""
        camera = self.camera.copy()
        camera[0] += along * camera[1] + down * camera[2]
        middle = (self.shape[1] * camera[1] + self.shape[0] * camera[2]) / 2
        wide, high = np.linalg.norm(camera[1]), np.linalg.norm(camera[2])
        u, v = camera[1] / wide, camera[2] / high
        camera[1] = wide * (math.cos(roll) * u + math.sin(roll) * v)
        camera[2] = high * (math.cos(roll) * v - math.sin(roll) * u)
        camera[0] += middle - (self.shape[1] * camera[1] + self.shape[0] * camera[2]) / 2
        return replace(self, camera=camera)

    def lights(self, dents: ArrayLike, sequence: Sequence, side: int = 4) -> NDArray[np.float32]:
        """Light (N, H, W) of every frame of a sequence, 1: all of a lit cell's."""
        tables = np.stack([_table(sequence, k, self.blur) for k in range(len(sequence))])
        light: NDArray[np.float32] = self._run(dents, side, tables)[0]
        return light

    def truth(self, dents: ArrayLike) -> Floats:
        """u, v, z, x, y (5, H, W) of the pixels' centres."""
        truth: Floats = self._run(dents, 1, np.zeros((1, 1, 1), np.float32))[1]
        return truth

    def _run(self, dents: ArrayLike, side: int, tables: NDArray[np.float32]) -> Any:
        light, truth = np.zeros((len(tables), *self.shape), np.float32), np.zeros((5, *self.shape))
        rows = np.asarray(dents, np.float64).reshape(-1, 5)
        end = self.size[0] if self.fading else 1e9
        layer = _on_layer() if (rows[:, 0] == LAYERED).any() else np.zeros((2, 2))
        args = self.camera, self.plane, self.size, rows, layer, end, self.index, side, tables, light, truth
        over_rows(lambda start, stop: _trace(start, stop, *args), self.shape[0], 16)
        return light, truth


def world_of(scene: Scene) -> World:
    """The numbers of a scene."""
    c: Any = scene.camera
    p = scene.pattern
    direction = np.cross(c.u_axis, c.v_axis)
    return World(
        (c.rows, c.cols),
        np.stack([c.origin, c.pitch[0] * c.u_axis, c.pitch[1] * c.v_axis, direction]),
        np.stack([p.origin, p.pitch * p.u_axis, p.pitch * p.v_axis]),
        np.array([scene.mirror.length, scene.mirror.width]),
        scene.medium.index if scene.medium is not None else 0.0,
        p.blur_px,
    )


def expose(
    light: NDArray[np.float32], rng: np.random.Generator, noise: float = 1.5, gain: float = 1.0
) -> Any:
    """uint8 frames of light through a camera with read noise (levels)."""
    levels = 8.0 + 216.0 * gain * light + noise * rng.standard_normal(light.shape, dtype=np.float32)
    return np.clip(np.rint(levels), 0, 255).astype(np.uint8)


def photons(light: NDArray[np.float32], rng: np.random.Generator, electrons: float = 30.0) -> Any:
    """uint8 frames of light through a camera with photon noise, so many electrons a level."""
    levels = rng.poisson(electrons * (8.0 + 216.0 * light)) / electrons
    return np.clip(np.rint(levels), 0, 255).astype(np.uint8)


@lru_cache(maxsize=2)
def _table(sequence: Sequence, index: int, blur: float) -> NDArray[np.float32]:
    """A frame's pattern, blurred; a stream shows one for all of its pictures."""
    cells = np.pad(sequence.render_frame(index).astype(np.float32) / 255, 4)
    wide = np.kron(cells, np.ones((_FINE, _FINE), np.float32))
    return np.asarray(gaussian_filter(wide, blur * _FINE, truncate=5))


@cache
def _on_layer() -> Floats:
    """Deflection (n, 2) and its slope by the distance in radii, 1 in the middle."""
    one = on_layer(1.0, 1.0, _THICK, 0.5)
    table, r = one.table(), np.arange(0, _NEAREST, _STEP)
    return np.stack([table(r), table(r, 1)], axis=1) / one.depth


@inlined
def _height(x, y, dents, layer, length):  # type: ignore[no-untyped-def]
    h, hx, hy = 0.0, 0.0, 0.0
    for k in range(dents.shape[0]):
        dx, dy, s, a = x - dents[k, 1], y - dents[k, 2], dents[k, 3], dents[k, 4]
        if dents[k, 0] == 0.0:
            e = a * np.exp(-0.5 * (dx * dx + dy * dy) / (s * s))
            h, hx, hy = h + e, hx - dx / (s * s) * e, hy - dy / (s * s) * e
        elif dents[k, 0] == 3.0:
            q = np.sqrt(dx * dx + dy * dy) / s
            m = min(int(q / _STEP), layer.shape[0] - 2)
            f = min(q / _STEP - m, 1.0)
            h += a * ((1 - f) * layer[m, 0] + f * layer[m + 1, 0])
            o = a * ((1 - f) * layer[m, 1] + f * layer[m + 1, 1]) / (s * s * max(q, 1e-9))
            hx, hy = hx + o * dx, hy + o * dy
        elif dents[k, 0] == 2.0:
            q2 = max((dx * dx + dy * dy) / (s * s), 1.0)
            h += a * 2 / np.pi * np.arcsin(1 / np.sqrt(q2))
            o = -a * 2 / np.pi / (q2 * np.sqrt(max(q2 - 1, 1e-6)) * s * s) if q2 > 1 else 0.0
            hx, hy = hx + o * dx, hy + o * dy
        else:
            q2 = (dx * dx + dy * dy) / (s * s)
            if q2 <= 1.0:
                h, o = h + a * (1 - 0.5 * q2), -a / (s * s)
            else:
                q = np.sqrt(q2)
                arc, root = np.arcsin(1 / q), np.sqrt(q2 - 1)
                h += a * ((2 - q2) * arc + root) / np.pi
                o = a / (s * s) * 2 * (root / q - q * arc) / (np.pi * q)
            hx, hy = hx + o * dx, hy + o * dy
    t = 0.1 * length
    u = min(max((length - x) / t, 0.0), 1.0)
    fade = u**4 * (35 - 84 * u + 70 * u * u - 20 * u**3)
    slope = -140 / t * u**3 * (1 - u) ** 3
    return h * fade, hx * fade + h * slope, hy * fade


@exact
def _trace(start, stop, cam, plane, size, dents, layer, end, index, side, tables, out, truth):  # type: ignore[no-untyped-def]
    o0, cu, cv, d = cam[0], cam[1], cam[2], cam[3]
    nx = plane[1, 1] * plane[2, 2] - plane[1, 2] * plane[2, 1]
    ny = plane[1, 2] * plane[2, 0] - plane[1, 0] * plane[2, 2]
    nz = plane[1, 0] * plane[2, 1] - plane[1, 1] * plane[2, 0]
    uu = plane[1, 0] ** 2 + plane[1, 1] ** 2 + plane[1, 2] ** 2
    vv = plane[2, 0] ** 2 + plane[2, 1] ** 2 + plane[2, 2] ** 2
    for r in range(start, stop):
        for c in range(out.shape[2]):
            for k in range(side * side):
                a, b = k // side, k % side  # a turned grid: all rays differ along both axes
                row = r + ((a + (side - b - 0.5) / side) / side - 0.5) * (side > 1)
                col = c + ((b + (a + 0.5) / side) / side - 0.5) * (side > 1)
                ox = o0[0] + col * cu[0] + row * cv[0]
                oy = o0[1] + col * cu[1] + row * cv[1]
                oz = o0[2] + col * cu[2] + row * cv[2]
                t, hx, hy = -oz / d[2], 0.0, 0.0
                for _ in range(30):
                    h, hx, hy = _height(ox + t * d[0], oy + t * d[1], dents, layer, end)
                    step = (oz + t * d[2] - h) / (d[2] - hx * d[0] - hy * d[1])
                    t -= step
                    if abs(step) < 1e-11:
                        break
                x, y, z = ox + t * d[0], oy + t * d[1], oz + t * d[2]
                norm = 1 / np.sqrt(1 + hx * hx + hy * hy)
                n0, n1, n2 = -hx * norm, -hy * norm, norm
                dn = d[0] * n0 + d[1] * n1 + d[2] * n2
                e0, e1, e2 = d[0] - 2 * dn * n0, d[1] - 2 * dn * n1, d[2] - 2 * dn * n2
                way = (plane[0, 0] - x) * nx + (plane[0, 1] - y) * ny + (plane[0, 2] - z) * nz
                way /= e0 * nx + e1 * ny + e2 * nz
                q0, q1, q2 = (
                    x + way * e0 - plane[0, 0],
                    y + way * e1 - plane[0, 1],
                    z + way * e2 - plane[0, 2],
                )
                u = (q0 * plane[1, 0] + q1 * plane[1, 1] + q2 * plane[1, 2]) / uu
                v = (q0 * plane[2, 0] + q1 * plane[2, 1] + q2 * plane[2, 2]) / vv
                if side == 1:
                    truth[0, r, c], truth[1, r, c], truth[2, r, c] = u, v, z
                    truth[3, r, c], truth[4, r, c] = x, y
                    continue
                if dn >= 0 or way <= 0 or x < 0 or x > size[0] or y < 0 or y > size[1]:
                    continue
                i, j = (v + 4.5) * _FINE - 0.5, (u + 4.5) * _FINE - 0.5
                if not (0 <= i < tables.shape[1] - 1 and 0 <= j < tables.shape[2] - 1):
                    continue
                share = 1.0
                if index > 0:
                    sin2 = index * index * (1 - dn * dn)
                    if sin2 < 1:
                        ct, ci = np.sqrt(1 - sin2), -dn
                        rs, rp = (index * ci - ct) / (index * ci + ct), (ci - index * ct) / (ci + index * ct)
                        share = 0.5 * (rs * rs + rp * rp)
                m, n = int(i), int(j)
                f, g = i - m, j - n
                for p in range(tables.shape[0]):
                    low = (1 - g) * tables[p, m, n] + g * tables[p, m, n + 1]
                    high = (1 - g) * tables[p, m + 1, n] + g * tables[p, m + 1, n + 1]
                    out[p, r, c] += share * ((1 - f) * low + f * high) / (side * side)
