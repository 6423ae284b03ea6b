"""What the pages of a demo and of saved records show of the result: height and error bars; beside a truth
profile and error.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from optolever.decode import Correspondence
from optolever.reconstruct import HeightMap
from optolever.scene import Trace

from .calibration import Quantity, histogram_figure, reliability_figure
from .images import figure_uri, label_axes, new_figure, robust_limits
from .maps import MirrorGrid, Panel, length_unit, mirror_figure
from .metrics import unflagged
from .surface_view import surface_data

__all__ = ["HeightView"]

Array = NDArray[np.float64]


@dataclass(frozen=True)
class HeightView:
    """Height (mm) and sigma of a map, NaN where a flag stands; `factor`, `unit`: how sigma and errors are
    written. correspondence, truth: as far as they are known.
    """

    height: HeightMap
    correspondence: Correspondence | None
    truth: Trace | None
    z: Array
    sigma: Array
    grid: MirrorGrid
    factor: float
    unit: str

    @classmethod
    def of(
        cls, height: HeightMap, correspondence: Correspondence | None = None, truth: Trace | None = None
    ) -> "HeightView":
        """The view of a map."""
        z, sigma = (np.where(height.good, one, np.nan) for one in (height.z, height.total_sigma))
        factor, unit = length_unit(float(np.median(sigma[height.good])) if height.good.any() else np.nan)
        grid = MirrorGrid.around(np.where(np.isfinite(z), height.x, np.nan), height.y)
        return cls(height, correspondence, truth, z, sigma * factor, grid, factor, unit)

    def surface(self) -> dict[str, Any]:
        """The data of the surface that can be turned."""
        layers = {"height": (self.z, "mm", "viridis", False)}
        if self.truth is not None:
            layers["error"] = (self.error(self.truth), self.unit, "RdBu_r", True)
        layers["sigma"] = (self.sigma, self.unit, "cividis", False)
        return surface_data(self.height.x, self.height.y, self.z, layers)

    def pictures(self) -> dict[str, str]:
        """Maps of the measured height, and of sigma: of the height, and of u and v."""
        title = "Measured height z, positive into the medium"
        deep = Panel(self.grid.place(self.z), title, "z [mm]", limits=robust_limits(self.z, 0.9999))
        bars = [Panel(self.grid.place(self.sigma), "Sigma of the height", f"sigma [{self.unit}]", "cividis")]
        seen = self.correspondence
        if seen is not None:
            both = self.grid.place(np.where(seen.good, np.hypot(seen.sigma_u, seen.sigma_v), np.nan))
            bars.append(Panel(both, "Sigma of the correspondence", "√(σu² + σv²) [px]", "cividis"))
        return {"height": mirror_figure([deep], self.grid), "sigma": mirror_figure(bars, self.grid)}

    def error(self, truth: Trace) -> Array:
        """Measured less true height, in `unit`, NaN where either is unknown."""
        return np.where(unflagged(truth, self.height), self.height.z - truth.z, np.nan) * self.factor

    def compared(self, seen: Correspondence, truth: Trace) -> dict[str, str]:
        """What the truth adds: profile, error, error against sigma."""
        error, decoded = self.error(truth), seen.good & truth.visible
        with np.errstate(divide="ignore", invalid="ignore"):
            ratio = self.grid.place(error / self.sigma)
        limits, title = robust_limits(error, symmetric=True), "Measured − true height"
        panels = [
            Panel(self.grid.place(error), title, f"error [{self.unit}]", "RdBu_r", limits),
            Panel(ratio, "The same over sigma", "error / sigma", "RdBu_r", (-4.0, 4.0)),
        ]
        quantities = [
            Quantity.of("u", "px", seen.u - truth.u, seen.sigma_u, decoded),
            Quantity.of("v", "px", seen.v - truth.v, seen.sigma_v, decoded),
            Quantity.of("height", self.unit, error, self.sigma, np.isfinite(error)),
        ]
        return {
            "profile": self._profile(truth, error),
            "error": mirror_figure(panels, self.grid),
            "histograms": histogram_figure(quantities),
            "reliability": reliability_figure(quantities),
        }

    def _profile(self, truth: Trace, error: Array) -> str:
        """The middle camera row: measured and true height, and the error with its band of two sigma."""
        row = self.z.shape[0] // 2
        order = np.argsort(truth.x[row])
        x, true, z, off, sigma = (
            field[row][order] for field in (truth.x, truth.z, self.z, error, self.sigma)
        )
        figure = new_figure(10.0, 4.6)
        upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=(1.3, 1))
        upper.plot(x, true, color="#9aa6b2", lw=4, label="true")
        upper.plot(x, z, color="#2563a8", lw=1.3, label="measured")
        label_axes(upper, "", "z [mm]")
        lower.fill_between(x, -2 * sigma, 2 * sigma, color="#e0a030", alpha=0.35, lw=0, label="±2 sigma")
        lower.plot(x, off, color="#b3402e", lw=0.8, label="error")
        lower.axhline(0, color="#5a6675", lw=0.6)
        limit = 1.15 * robust_limits(np.concatenate([off, 2.5 * sigma]), symmetric=True)[1]
        lower.set_ylim(-limit, limit)
        label_axes(lower, "x [mm]", f"error [{self.unit}]")
        for axes in (upper, lower):
            axes.legend(fontsize=8, frameon=False, ncols=2)
        return figure_uri(figure)
