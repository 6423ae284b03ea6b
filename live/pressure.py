"""Force of live contacts, each frame for itself."""

import math

import cv2
import numpy as np

from optolever.contact import forces_on
from optolever.scene import Layer

from .arrays import Cells, Float
from .contact import Force, Touch
from .prepared import Prepared
from .reading import Reading

__all__ = ["Forces"]

_DEGREE = 4  # of the polynomial that gives a cell's row and column from x and y


class Forces:
    """Forces of the contacts of a prepared rig's readings; each frame for itself."""

    def __init__(self, prepared: Prepared, layer: Layer) -> None:
        self._prepared, self._layer = prepared, layer
        lit = prepared.rig.lit
        x, y = (prepared.points[i][lit].astype(np.float64) for i in (0, 1))
        self._middle = np.array([x.mean(), y.mean()])
        self._extent = float(max(np.ptp(x), np.ptp(y), 1e-6))
        basis = self._basis(x, y)
        self._to_row, self._to_col = (
            np.linalg.lstsq(basis, index.astype(np.float64), rcond=None)[0] for index in np.nonzero(lit)
        )

    def update(
        self, reading: Reading, touches: tuple[Touch, ...], common: Cells | None = None
    ) -> tuple[Force, ...]:
        """The force of every contact, in the contacts' order. common (R, C): the part of the heights' sigma
        that they have in common, in the contacts' sigmas too."""
        if not touches:
            return ()
        circles = [(one.x, one.y, math.sqrt(one.area / math.pi)) for one in touches]
        found = forces_on(self._layer, circles, lambda at, pitch: self._sampled(reading.z, at, pitch))
        pressure, owner, area = found.pressure, found.owner, found.pitch**2
        peak = max(touches, key=lambda one: one.depth)
        shared = np.zeros_like(reading.z) if common is None else common
        at_peak = float(self._sampled(shared, np.array([[peak.x, peak.y]]), found.pitch)[0])
        noise = math.sqrt(max(peak.depth_sigma**2 - at_peak**2, 0.0))
        factor = noise / float(np.median(self._prepared.noise.sigma[self._prepared.rig.lit]))
        draws = self._sampled(self._prepared.noise.draws, found.places, found.pitch)
        spread = np.sqrt(np.mean(np.square(draws @ found.weights.T), axis=0)) * factor
        spread = np.hypot(spread, found.weights @ self._sampled(shared, found.places, found.pitch))
        newton = [float(pressure[owner == k].sum() * area) for k in range(len(touches))]
        modulus = self._layer.relative_sigma
        return tuple(
            Force(
                touch.identity,
                newton[k],
                math.hypot(float(spread[k] * area), newton[k] * modulus),
                float(pressure[owner == k].max(initial=0.0)),
            )
            for k, touch in enumerate(touches)
        )

    def _basis(self, x: Float, y: Float) -> Float:
        a, b = (x - self._middle[0]) / self._extent, (y - self._middle[1]) / self._extent
        powers = [a**i * b**j for i in range(_DEGREE + 1) for j in range(_DEGREE + 1 - i)]
        return np.stack(powers, axis=-1)

    def _sampled(self, z: Cells, places: Float, pitch: float) -> Float:
        """Mean heights (..., n) of squares around places (n, 2); z (..., R, C)."""
        basis = self._basis(places[:, 0], places[:, 1])
        row, col = (
            np.clip(basis @ part, 0, size - 1.001)
            for part, size in zip((self._to_row, self._to_col), z.shape[-2:], strict=True)
        )
        i, j = row.astype(np.int64), col.astype(np.int64)
        down, along = row - i, col - j
        side = max(1, round(pitch / math.sqrt(self._prepared.area)))
        smooth = _blurred(z, side)
        above = (1 - along) * smooth[..., i, j] + along * smooth[..., i, j + 1]
        below = (1 - along) * smooth[..., i + 1, j] + along * smooth[..., i + 1, j + 1]
        return np.asarray((1 - down) * above + down * below, np.float64)


def _blurred(z: Cells, side: int) -> Cells:
    """Means over squares of cells; z (..., R, C)."""
    flat = z.reshape(-1, *z.shape[-2:])
    return np.stack([cv2.blur(one, (side, side)) for one in flat]).reshape(z.shape)
