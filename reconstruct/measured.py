"""What a solve works on: the measurement and the geometry of one pixel grid."""

from dataclasses import dataclass, replace

import numpy as np

from optolever.scene import PatternShape

from .arrays import Floats, Mask
from .geometry import RayField, rest_distance
from .solver.equations import no_normal, slope_variances, slopes

__all__ = ["Measured"]

#: Share of pixels, at least, in the middles of a discrete code's cells: in noise its decoder returns means
#: of several cells (of up to 88 % of the pixels). Coordinates of other codes are nowhere exactly at a middle.
_MIDDLES = 0.05
#: Rows sampled for that, about.
_ROWS = 64


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
        rows = slice(None, None, max(1, len(self.u) // _ROWS))
        seen = self.mask[rows] & ~bridged[rows]
        values = (part[rows][seen] for part in (self.u, self.v))
        return all(bool(np.mean(2 * x == np.rint(2 * x)) > _MIDDLES) for x in values)

    def noisier(self, times: float) -> "Measured":
        """With sigma so many times larger."""
        return replace(self, sigma_u=times * self.sigma_u, sigma_v=times * self.sigma_v)

    def shifted(self, du: Floats, dv: Floats) -> "Measured":
        """With u and v moved, pattern pixels."""
        return replace(self, u=self.u + du, v=self.v + dv)

    def slopes(self, w: Floats) -> tuple[Floats, ...]:
        """p, q, dp/dw, dq/dw at w."""
        return slopes(self.rays, self.plane, *self._on_plane(w), w)

    def variances(self, w: Floats) -> tuple[Floats, Floats]:
        """Variances of p and q at w."""
        u, v = self._on_plane(w)
        return slope_variances(self.rays, self.plane, u, v, self.sigma_u, self.sigma_v, w)

    def singular(self, w: Floats, picard: bool = False) -> Mask:
        """Pixels of the mask to which noise leaves no normal if the mirror is at w, see
        `equations.no_normal`; picard: and those where a fixed point is none, since slopes change with w by
        as much as w over a pixel.
        """
        sigmas = self.sigma_u, self.sigma_v
        u, v = self._on_plane(w)
        found = no_normal(self.rays, self.plane, u, v, *sigmas, w, *self.variances(w))
        if picard:
            found |= self.sensitive(w, 1.0)
        return found & self.mask

    def sensitive(self, w: Floats, limit: float) -> Mask:
        """Pixels of the mask where a change of w changes a slope, over one pixel, by at least `limit` times
        itself, as close to the pattern.
        """
        _, _, p_w, q_w = self.slopes(w)
        found: Mask = np.maximum(np.abs(p_w), np.abs(q_w)) >= limit
        return found & self.mask

    def clearance(self, w: Floats) -> Floats:
        """Distance from the mirror point at w to the pattern point, mm; NaN where u or v is."""
        u, v = self._on_plane(w)
        seen = self.plane[0] + u[..., None] * self.plane[1] + v[..., None] * self.plane[2]
        away: Floats = np.linalg.norm(np.moveaxis(seen, -1, 0) - self._points(w), axis=0)
        return away

    def _points(self, w: Floats) -> Floats:
        """Mirror points (3, rows, cols) at w, mm."""
        points: Floats = self.rays.inner_origins + self.distance(w) * self.rays.inner_directions
        return points

    def _on_plane(self, w: Floats) -> tuple[Floats, Floats]:
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

    def unknown(self, distance: Floats) -> Floats:
        """t -> w."""
        return np.log(distance) if self.rays.logarithmic else distance

    def distance(self, w: Floats) -> Floats:
        """w -> t in mm."""
        return np.exp(w) if self.rays.logarithmic else w
