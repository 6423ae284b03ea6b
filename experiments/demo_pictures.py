"""What the demo report shows of the result: height, profile, error, error bars."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .calibration import Quantity, histogram_figure, reliability_figure
from .demo import DemoResult
from .images import figure_uri, label_axes, new_figure, robust_limits
from .maps import MirrorGrid, Panel, length_unit, mirror_figure
from .metrics import unflagged
from .surface_view import surface_data

__all__ = ["HeightView"]

Array = NDArray[np.float64]


@dataclass(frozen=True)
class HeightView:
    """Height, sigma and error of a run with NaN where a flag stands; `factor`, `unit`: how errors are
    written.
    """

    result: DemoResult
    z: Array
    sigma: Array
    error: Array
    stands: NDArray[np.bool_]
    grid: MirrorGrid
    factor: float
    unit: str

    @classmethod
    def of(cls, result: DemoResult) -> "HeightView":
        """The view of a run."""
        height, stands = result.height, unflagged(result.truth, result.height)
        factor, unit = length_unit(result.metrics["height_rms_mm"])
        z = np.where(height.good, height.z, np.nan)
        return cls(
            result=result,
            z=z,
            sigma=np.where(height.good, height.sigma, np.nan) * factor,
            error=np.where(stands, height.z - result.truth.z, np.nan) * factor,
            stands=stands,
            grid=MirrorGrid.around(np.where(np.isfinite(z), height.x, np.nan), height.y),
            factor=factor,
            unit=unit,
        )

    def surface(self) -> dict[str, Any]:
        """The data of the surface that can be turned."""
        layers = {
            "height": (self.z, "mm", "viridis", False),
            "error": (self.error, self.unit, "RdBu_r", True),
            "sigma": (self.sigma, self.unit, "cividis", False),
        }
        return surface_data(self.result.height.x, self.result.height.y, self.z, layers)

    def height_map(self) -> str:
        """Measured height on the mirror."""
        title = "Measured height z, positive into the medium"
        panel = Panel(self.grid.place(self.z), title, "z [mm]", limits=robust_limits(self.z, 0.9999))
        return mirror_figure([panel], self.grid)

    def error_map(self) -> str:
        """Error, and error in units of its own sigma."""
        with np.errstate(divide="ignore", invalid="ignore"):
            ratio = self.error / self.sigma
        limits = robust_limits(self.error, symmetric=True)
        panels = [
            Panel(
                self.grid.place(self.error),
                "Measured − true height",
                f"error [{self.unit}]",
                "RdBu_r",
                limits,
            ),
            Panel(self.grid.place(ratio), "The same over sigma", "error / sigma", "RdBu_r", (-4.0, 4.0)),
        ]
        return mirror_figure(panels, self.grid)

    def sigma_map(self) -> str:
        """Sigma of height and of the correspondence on the mirror."""
        seen = self.result.correspondence
        sigma_uv = np.where(seen.good, np.hypot(seen.sigma_u, seen.sigma_v), np.nan)
        panels = [
            Panel(self.grid.place(self.sigma), "Sigma of the height", f"sigma [{self.unit}]", "cividis"),
            Panel(self.grid.place(sigma_uv), "Sigma of the correspondence", "√(σu² + σv²) [px]", "cividis"),
        ]
        return mirror_figure(panels, self.grid)

    def quantities(self) -> list[Quantity]:
        """Errors and sigmas of u, v and height over unflagged pixels."""
        seen, truth = self.result.correspondence, self.result.truth
        decoded = seen.good & truth.visible
        return [
            Quantity.of("u", "px", seen.u - truth.u, seen.sigma_u, decoded),
            Quantity.of("v", "px", seen.v - truth.v, seen.sigma_v, decoded),
            Quantity.of("height", self.unit, self.error, self.sigma, self.stands),
        ]

    def histograms(self) -> str:
        """Error over sigma against the unit normal."""
        return histogram_figure(self.quantities())

    def reliability(self) -> str:
        """Measured against predicted error."""
        return reliability_figure(self.quantities())

    def profile(self) -> str:
        """The middle camera row: measured and true height, and the error with its band of two sigma."""
        row = self.z.shape[0] // 2
        order = np.argsort(self.result.truth.x[row])
        x, true, z, error, sigma = (
            field[row][order]
            for field in (self.result.truth.x, self.result.truth.z, self.z, self.error, self.sigma)
        )
        figure = new_figure(10.0, 4.6)
        upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=(1.3, 1))
        upper.plot(x, true, color="#9aa6b2", lw=4, label="true")
        upper.plot(x, z, color="#2563a8", lw=1.3, label="measured")
        label_axes(upper, "", "z [mm]")
        lower.fill_between(x, -2 * sigma, 2 * sigma, color="#e0a030", alpha=0.35, lw=0, label="±2 sigma")
        lower.plot(x, error, color="#b3402e", lw=0.8, label="error")
        lower.axhline(0, color="#5a6675", lw=0.6)
        limit = 1.15 * robust_limits(np.concatenate([error, 2.5 * sigma]), symmetric=True)[1]
        lower.set_ylim(-limit, limit)
        label_axes(lower, "x [mm]", f"error [{self.unit}]")
        for axes in (upper, lower):
            axes.legend(fontsize=8, frameon=False, ncols=2)
        return figure_uri(figure)
