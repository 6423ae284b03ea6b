"""What a solve works on: the measurement and the rays of one pixel grid, and the mirror's equations there.

The mirror point is P = o + t d, the pattern point X(u, v), e = (X - P)/|X - P|. The normal bisects, n ~ e -
d, and the mirror's tangents are normal to it, n . dP/di = 0; hence with the ray field's derivative along a
pixel axis

    p = dt/di = -n . (o_i + t d_i) / (n . d)

and, with the tangent T = o_i + t d_i + p d, any change of the normal moves it by dp = -(dn . T) / (n . d);
dn/dt = -(d - (d.e) e)/|X - P| gives p_t (plus the change of the tangent itself, -n . d_i / (n . d)),
dn/du = (U - (U.e) e)/|X - P| the error that the decoder's sigma causes.
With the unknown w = log t, the slopes are p/t, their derivative with respect to w is p_t - p/t.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from optolever.arrays import Floats, Mask, Pair, some_rows
from optolever.blocks import over_image, over_rows
from optolever.kernels import kernel
from optolever.scene import PatternShape

from .geometry import PAD, RayField, rest_distance

__all__ = ["Measured"]

_SWING = 0.05  # noise over the way to the pattern: what noise does to a slope depends on where noise put it
_SURE = 3.0  # standard deviations: beyond them lies noise of a normal distribution but for 0.3 %
_ALONG, _ACROSS = 2, 1  # rows and columns on either side that predict where it lies without noise
#: Share of pixels, at least, in the middles of a discrete code's cells: in noise its decoder returns means
#: of several cells (of up to 88 % of the pixels). Coordinates of other codes are nowhere exactly at a middle.
_MIDDLES = 0.05
#: Rows sampled for that, about.
_BLOCK = 1 << 14  # pixels at once: what they need stays in the cache
_MARGIN = 1e4  # between the noise at two places of the mirror, at most


@dataclass(frozen=True, slots=True)
class Measured:
    """Correspondences on a grid with their rays.

    u, v, sigma_u, sigma_v (rows, cols) pattern pixels, used where mask is true; plane (3, 3): see
    `geometry.pattern_plane`; shape: of the pattern's surface off that plane. With one, a mirror at w looks at
    the place of the plane on the line to the pattern point: slopes depend on the direction alone.
    """

    rays: RayField
    plane: Floats
    u: Floats
    v: Floats
    sigma_u: Floats
    sigma_v: Floats
    mask: Mask
    shape: PatternShape | None = None

    def whole_cells(self, bridged: Mask) -> bool:
        """Whether u and v come from a discrete code: middles of cells, multiples of half a pixel. Their
        errors are those of neighbours, so that differences of neighbours say nothing about them.
        bridged (rows, cols): pixels that were interpolated.
        """
        rows = some_rows(self.u)
        seen = self.mask[rows] & ~bridged[rows]
        values = (part[rows][seen] for part in (self.u, self.v))
        return all(bool(np.mean(2 * x == np.rint(2 * x)) > _MIDDLES) for x in values)

    def slopes(self, w: Floats) -> tuple[Floats, ...]:
        """Slopes p, q (along columns, along rows) of the unknown at w, and their derivatives dp/dw, dq/dw;
        (rows, cols) each, NaN where u or v is."""
        u, v = self._on_plane(w)
        found, moving = np.empty((4, *w.shape)), (int(self.rays.logarithmic), 1 if self.rays.parallel else 2)
        with np.errstate(over="ignore", invalid="ignore"):
            t = self.distance(w)
            arrays = self.rays.origins, self.rays.directions, *moving, self.plane, u, v, t, found
            over_image(
                lambda start, stop: _slopes(*arrays, np.zeros((4, 3, w.shape[1])), start, stop), w.shape
            )
            if self.rays.logarithmic:
                found[:2] /= t
                found[2:] -= found[:2]
        p, q, p_w, q_w = found
        return p, q, p_w, q_w

    def variances(self, w: Floats, every: int = 1, where: Mask | None = None) -> Pair:
        """Variances of p and q at w that the standard deviations of u and v cause, (rows, cols) each; NaN but
        in every such row, and but around the pixels `where` (rows, cols) they are asked for.

        Where the noise is large as against the way to the pattern, that way is the one without noise: to the
        mean of neighbours.
        """
        found = np.full(w.shape, np.nan), np.full(w.shape, np.nan)
        noisy, (u, v) = np.zeros(w.shape, np.bool_), self._on_plane(w)

        def spread(down: slice, along: slice, again: bool) -> None:
            def block(start: int, stop: int) -> None:
                rows = slice(down.start + start, min(down.start + stop, down.stop), every)
                self._spread((rows, along), w, u, v, found, noisy, again)

            over_rows(block, down.stop - down.start, every * max(1, _BLOCK // (along.stop - along.start)))

        every_pixel = slice(0, w.shape[0]), slice(0, w.shape[1])
        down, along = every_pixel if where is None else (_extent(where, 1), _extent(where, 0))
        spread(down, along, again=False)
        if noisy.any():
            u, v = (_amid(at, noisy) for at in (u, v))
            spread(_extent(noisy, 1), _extent(noisy, 0), again=True)
        return found

    def _spread(
        self,
        window: tuple[slice, slice],
        w: Floats,
        u: Floats,
        v: Floats,
        found: Pair,
        noisy: Mask,
        again: bool,
    ) -> None:
        """Fill in the variances of a window, u and v on the plane, and mark pixels whose noise is large;
        again: of these alone."""
        o, d = self.rays.origins, self.rays.directions
        rows, cols = window[0], slice(PAD + window[1].start, PAD + window[1].stop)

        def at(a: Floats, k: int, down: int = 0, right: int = 0) -> Floats:
            start = PAD + rows.start + down
            return a[k, start : PAD + rows.stop + down : rows.step, cols.start + right : cols.stop + right]

        def change(a: Floats, k: int, down: int, right: int) -> Floats | float:
            if self.rays.logarithmic if a is o else self.rays.parallel:
                return 0.0
            near = at(a, k, down, right) - at(a, k, -down, -right)
            near *= 8.0 / 12.0
            near -= (at(a, k, 2 * down, 2 * right) - at(a, k, -2 * down, -2 * right)) / 12.0
            return near

        t = np.exp(w[window]) if self.rays.logarithmic else w[window]
        start, *axes = self.plane
        ray = [at(d, k) for k in range(3)]
        with np.errstate(all="ignore"):
            e = [
                start[k] + u[window] * axes[0][k] + v[window] * axes[1][k] - at(o, k) - t * ray[k]
                for k in range(3)
            ]
            square = e[0] * e[0] + e[1] * e[1] + e[2] * e[2]
            inverse = 1.0 / np.sqrt(square)
            e = [part * inverse for part in e]
            n = [part - along for part, along in zip(e, ray, strict=True)]
            scale = 1.0 / _dot(n, ray)
            sigmas = self.sigma_u[window], self.sigma_v[window]
            forward = [_dot(axis, e) for axis in axes]
            noise, ahead = (
                sum(np.square(sigma) * part for sigma, part in zip(sigmas, parts, strict=True))
                for parts in ((axis @ axis for axis in axes), map(np.square, forward))
            )
            large = noise > _SWING**2 * square
            # to second order: noise along the way changes what noise across it does
            factor = (1.0 + 3.0 * ahead / square) * np.square(
                scale * inverse / (t if self.rays.logarithmic else 1)
            )
            for out, step in zip(found, ((0, 1), (1, 0)), strict=True):
                # the tangent, and its changes by moves of X less their part along e
                a = [change(o, k, *step) + t * change(d, k, *step) for k in range(3)]
                slope = scale * _dot(n, a)
                a = [part - slope * along for part, along in zip(a, ray, strict=True)]
                along = _dot(e, a)
                total = sum(
                    np.square(sigma * (_dot(axis, a) - part * along))
                    for sigma, axis, part in zip(sigmas, axes, forward, strict=True)
                )
                if again:
                    np.copyto(out[window], factor * total, where=noisy[window])
                else:
                    np.multiply(factor, total, out=out[window])
        if not again:
            noisy[window] = large

    def singular(
        self, w: Floats, variances: Pair | None = None, usual: Floats | None = None
    ) -> tuple[Mask, Floats]:
        """Pixels of the mask to which noise leaves no normal n ~ e - d if the mirror is at w; and, per pixel,
        the square of the way to the pattern times that of the noise of its slopes.

        e has no direction where X is at P, and is d where X is on the ray's way on from P: X must be farther
        from that half-line than its noise may move it, and farther from P than a pixel's noisy slopes move P.
        usual: that product at another w, much as here: variances are computed where a pixel comes near.
        """
        away, across = self.ways(w)
        pitch = np.square(self.plane[1:]).sum(axis=1)
        noise = np.maximum(pitch[0] * np.square(self.sigma_u), pitch[1] * np.square(self.sigma_v))
        with np.errstate(invalid="ignore", over="ignore"):
            found: Mask = ~(across > _SURE**2 * noise)
            if usual is None:
                moved = np.maximum(*(self.variances(w) if variances is None else variances))
                if self.rays.logarithmic:
                    moved *= np.square(self.distance(w))
                return (found | ~(away > moved)) & self.mask, away * moved
            near = self.mask & ~(away * away > _MARGIN * usual)
            if near.any():
                p, q = self.variances(w, where=near)
                moved = np.maximum(p[near], q[near])
                if self.rays.logarithmic:
                    moved *= np.square(self.distance(w[near]))
                found[near] |= ~(away[near] > moved)
        return found & self.mask, usual

    def ways(self, w: Floats) -> Pair:
        """Squares of the ways from the mirror points at w to the pattern points, and to the rays' ways on
        from P, (rows, cols) mm^2."""
        (u, v), found = self._on_plane(w), np.empty((2, *w.shape))
        o, d = self.rays.inner_origins, self.rays.inner_directions

        def block(start: int, stop: int) -> None:
            rows = slice(start, stop)
            t, (square, across) = self.distance(w[rows]), found[:, rows]
            square[:], ahead = 0.0, np.zeros(t.shape)
            for (at, by_u, by_v), origin, along in zip(self.plane.T, o[:, rows], d[:, rows], strict=True):
                e = u[rows] * by_u
                e += v[rows] * by_v
                e += at - origin
                e -= t * along
                ahead += e * along
                square += np.square(e, out=e)
            np.subtract(square, np.square(np.maximum(ahead, 0.0, out=ahead)), out=across)

        with np.errstate(invalid="ignore", over="ignore"):
            over_rows(block, len(w), max(1, _BLOCK // w.shape[1]))
        return found[0], found[1]

    def to_pattern(self, w: Floats) -> Floats:
        """X - P, from the mirror points at w to the pattern points, (3, rows, cols) mm."""
        (u, v), way = self._on_plane(w), self._points(w)
        for part, (start, by_u, by_v) in zip(way, self.plane.T, strict=True):
            np.subtract(start + u * by_u + v * by_v, part, out=part)
        return way

    def _points(self, w: Floats) -> Floats:
        """Mirror points (3, rows, cols) at w, mm."""
        points = self.distance(w) * self.rays.inner_directions
        points += self.rays.inner_origins
        return points

    def _on_plane(self, w: Floats) -> Pair:
        """u and v of the projections of the pattern's points from w onto its plane.

        e/h of the way from point to mirror, whose height over the plane is h, e that of the pattern point.
        """
        if self.shape is None:
            return self.u, self.v
        pitch = np.linalg.norm(self.plane[1:], axis=1)
        axes = self.plane[1:] / pitch[:, None]
        offset = self.shape.offset(self.u, self.v)
        local = np.tensordot(
            np.stack([*axes, np.cross(*axes)]), self._points(w) - self.plane[0][:, None, None], 1
        )
        with np.errstate(divide="ignore", invalid="ignore"):
            share = offset[..., 2] / (local[2] - offset[..., 2])
        u, v = (
            (at := own + offset[..., k] / pitch[k]) - share * (local[k] / pitch[k] - at)
            for k, own in enumerate((self.u, self.v))
        )
        return u, v

    def rest(self) -> Floats:
        """The unknown of the mirror at rest: t in mm, or log t."""
        return self.unknown(rest_distance(self.rays.inner_origins, self.rays.inner_directions))

    def points_at_rest(self) -> Floats:
        """Points (3, rows, cols) of the mirror at rest, mm."""
        return self._points(self.rest())

    def unknown(self, distance: Floats) -> Floats:
        """t -> w."""
        return np.log(distance) if self.rays.logarithmic else distance

    def distance(self, w: Floats) -> Floats:
        """w -> t in mm."""
        return np.exp(w) if self.rays.logarithmic else w


@kernel
def _slopes(o, d, first, last, plane, u, v, t, found, changes, start, stop):  # type: ignore[no-untyped-def]
    """In each pixel the change of t along both axes (0: along the row), and its derivative by t; n: the
    normal, g: change of the ray's direction, a: of its point, to the fourth order, kept in changes (4, 3,
    cols), what does not change left out (from `first` to `last`). As n . T = 0, the part of T along e is that
    along d, and n's change by t moves p by -(T . d) / |X - P|."""
    cols = u.shape[1]
    for i in range(start, stop):
        r = PAD + i
        for part in range(first, last):
            for k in range(3):
                a = o[k]
                if part == 1:
                    a = d[k]
                for j in range(cols):
                    c = PAD + j
                    near, far = a[r, c + 1] - a[r, c - 1], a[r, c + 2] - a[r, c - 2]
                    changes[2 * part, k, j] = (8.0 * near - far) / 12.0
                    near, far = a[r + 1, c] - a[r - 1, c], a[r + 2, c] - a[r - 2, c]
                    changes[2 * part + 1, k, j] = (8.0 * near - far) / 12.0
        for j in range(cols):
            c, away = PAD + j, t[i, j]
            dx, dy, dz = d[0, r, c], d[1, r, c], d[2, r, c]
            ex = plane[0, 0] + u[i, j] * plane[1, 0] + v[i, j] * plane[2, 0] - o[0, r, c] - away * dx
            ey = plane[0, 1] + u[i, j] * plane[1, 1] + v[i, j] * plane[2, 1] - o[1, r, c] - away * dy
            ez = plane[0, 2] + u[i, j] * plane[1, 2] + v[i, j] * plane[2, 2] - o[2, r, c] - away * dz
            inverse = 1.0 / math.sqrt(ex * ex + ey * ey + ez * ez)
            nx, ny, nz = ex * inverse - dx, ey * inverse - dy, ez * inverse - dz
            scale = -1.0 / (nx * dx + ny * dy + nz * dz)
            for axis in range(2):
                gx, gy, gz = changes[2 + axis, 0, j], changes[2 + axis, 1, j], changes[2 + axis, 2, j]
                ax = changes[axis, 0, j] + away * gx
                ay = changes[axis, 1, j] + away * gy
                az = changes[axis, 2, j] + away * gz
                slope = scale * (nx * ax + ny * ay + nz * az)
                found[axis, i, j] = slope
                along = dx * ax + dy * ay + dz * az + slope
                found[2 + axis, i, j] = scale * (nx * gx + ny * gy + nz * gz) - inverse * along


def _amid(values: Floats, where: Mask) -> Floats:
    """The values, there replaced by the mean of the pixel and its known neighbours, opposite ones only, so
    that what is linear stays."""
    around = np.pad(values, ((_ALONG, _ALONG), (_ACROSS, _ACROSS)), constant_values=np.nan)
    windows = np.lib.stride_tricks.sliding_window_view(around, (2 * _ALONG + 1, 2 * _ACROSS + 1))[where]
    means = values.copy()
    means[where] = np.nanmean(0.5 * (windows + windows[:, ::-1, ::-1]), axis=(1, 2))
    return means


def _extent(pixels: Mask, axis: int) -> slice:
    """From the first to the last line that holds some."""
    at = np.flatnonzero(pixels.any(axis=axis))
    return slice(int(at[0]), int(at[-1]) + 1)


def _dot(one: Sequence[Any], other: Sequence[Any]) -> Any:
    """The sum of the products of two vectors' components."""
    return one[0] * other[0] + one[1] * other[1] + one[2] * other[2]
