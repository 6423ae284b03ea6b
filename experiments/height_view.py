"""What the pages of a demo and of saved records show of the result: height and error bars, the surface that
can be turned; beside a truth profile, error, histograms of error / sigma, measured against predicted error.
"""

import base64
from dataclasses import dataclass
from typing import Any

import matplotlib
import numpy as np
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter
from numpy.typing import NDArray

from optolever.decode import Correspondence
from optolever.reconstruct import Grid, HeightMap
from optolever.scene import Trace

from .arrays import Floats, Mask
from .images import (
    MirrorGrid,
    Panel,
    figure_uri,
    label_axes,
    length_unit,
    mirror_figure,
    new_figure,
    robust_limits,
)
from .metrics import unflagged

VERTICES = 150  # of the surface, on the longer side
BINS = 12
MOST = 400_000  # samples that enter a figure; the numbers on the page use them all
#: Of pixels: errors and their sigmas, (n,) each.
Scores = tuple[NDArray[np.floating[Any]], NDArray[np.floating[Any]]]


@dataclass(frozen=True)
class HeightView:
    """Height (mm) and sigma (noise and rig) of a map, NaN where a flag stands; `factor`, `unit`: how sigma
    and errors are written. correspondence, truth: as far as they are known.
    """

    height: HeightMap
    correspondence: Correspondence | None
    truth: Trace | None
    z: Floats
    sigma: Floats
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
        """Maps of the measured height, and of sigma: of the height by noise, by the rig, of u and v."""
        title = "Measured height z, positive into the medium"
        deep = Panel(self.grid.place(self.z), title, "z [mm]", limits=robust_limits(self.z, 0.9999))
        bars = [self._bar("Sigma of the height by noise", self.height.sigma)]
        if self.height.calibration is not None:
            bars.append(self._bar("Sigma of the height by the rig", self.height.calibration_sigma))
        seen = self.correspondence
        if seen is not None:
            both = self.grid.place(np.where(seen.good, np.hypot(seen.sigma_u, seen.sigma_v), np.nan))
            bars.append(Panel(both, "Sigma of the correspondence", "√(σu² + σv²) [px]", "cividis"))
        return {"height": mirror_figure([deep], self.grid), "sigma": mirror_figure(bars, self.grid)}

    def _bar(self, title: str, sigma: Floats) -> Panel:
        """A map of standard deviations (mm) of the good pixels, in a unit of its own."""
        good = self.height.good
        factor, unit = length_unit(float(np.median(sigma[good])) if good.any() else np.nan)
        known = np.where(good, sigma, np.nan) * factor
        return Panel(self.grid.place(known), title, f"sigma [{unit}]", "cividis")

    def error(self, truth: Trace) -> Floats:
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
        told = {
            "u": scores(seen.u - truth.u, seen.sigma_u, decoded),
            "v": scores(seen.v - truth.v, seen.sigma_v, decoded),
            "height": scores(error, self.sigma, np.isfinite(error)),
        }
        return {
            "profile": self._profile(truth, error),
            "error": mirror_figure(panels, self.grid),
            "histograms": histogram_figure(told),
            "reliability": reliability_figure(told, self.unit),
        }

    def _profile(self, truth: Trace, error: Floats) -> str:
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


def scores(error: NDArray[np.floating[Any]], sigma: NDArray[np.floating[Any]], where: Mask) -> Scores:
    """Of the pixels where `where` holds and sigma is a positive number; of at most MOST, evenly taken."""
    use = where & np.isfinite(sigma) & (sigma > 0) & np.isfinite(error)
    step = max(1, -(-int(use.sum()) // MOST))
    return error[use][::step], sigma[use][::step]


def reliability(error: NDArray[np.floating[Any]], sigma: NDArray[np.floating[Any]]) -> tuple[Floats, Floats]:
    """Rms sigma and rms error in BINS bins of equally many pixels, sorted by sigma."""
    order = np.argsort(sigma, kind="stable")
    groups = [group for group in np.array_split(order, BINS) if group.size]
    predicted = np.array([np.sqrt(np.mean(sigma[group] ** 2)) for group in groups])
    measured = np.array([np.sqrt(np.mean(error[group] ** 2)) for group in groups])
    return predicted, measured


def histogram_figure(told: dict[str, Scores]) -> str:
    """Histograms of error / sigma beside the unit normal density."""
    figure = new_figure(10.0, 2.9)
    t = np.linspace(-5, 5, 201)
    for axes, (name, (error, sigma)) in zip(figure.subplots(1, len(told)), told.items(), strict=True):
        if error.size:
            axes.hist(
                np.clip(error / sigma, -5, 5), bins=np.linspace(-5, 5, 81), density=True, color="#6c9bcf"
            )
        axes.plot(t, np.exp(-(t**2) / 2) / np.sqrt(2 * np.pi), color="#b3402e", lw=1.4, label="unit normal")
        label_axes(axes, "error / sigma", title=name)
        axes.set_xlim(-5, 5)
        axes.set_ylim(0, 0.55)
    figure.axes[0].set_ylabel("density", fontsize=9)
    figure.axes[0].legend(fontsize=8, frameon=False, loc="upper left")
    return figure_uri(figure)


def reliability_figure(told: dict[str, Scores], length: str) -> str:
    """Measured rms error against predicted sigma, in bins of sigma; on the line the error bars are true.
    length: unit of heights."""
    figure = new_figure(10.0, 3.1)
    for axes, (name, (error, sigma)) in zip(figure.subplots(1, len(told)), told.items(), strict=True):
        if error.size:
            predicted, measured = reliability(error, sigma)
            positive = measured[measured > 0]
            ends = min(predicted.min(), positive.min(initial=np.inf)), max(predicted.max(), measured.max())
            span = np.array([ends[0] / 1.5, ends[1] * 1.5])
            axes.fill_between(span, span / 1.25, span * 1.25, color="#1f7a4d", alpha=0.12, lw=0)
            axes.plot(span, span, color="#5a6675", lw=1)
            axes.loglog(predicted, measured, "o", ms=4.5, color="#2563a8")
            for axis, limits in ((axes.xaxis, axes.set_xlim), (axes.yaxis, axes.set_ylim)):
                limits(*span)
                subs = (1.0, 2.0, 5.0) if span[1] < 30 * span[0] else (1.0,)
                axis.set_major_locator(LogLocator(subs=subs))
                axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:.3g}"))
                axis.set_minor_formatter(NullFormatter())
        unit = length if name == "height" else "px"
        label_axes(axes, f"predicted sigma [{unit}]", f"rms error [{unit}]", name)
    return figure_uri(figure)


def surface_data(
    x: Floats, y: Floats, z: Floats, layers: dict[str, tuple[Floats, str, str, bool]]
) -> dict[str, Any]:
    """What report/viewer.js reads, from mirror points x, y, z in mm (H, W), NaN where unknown.

    Heights and layers are interpolated at the vertices of a grid of at most VERTICES a side. layers: name ->
    (values, unit, colour map, symmetric), one per way of colouring the surface.
    """
    known = np.isfinite(z)
    size = np.array([np.ptp(axis[known]) if known.any() else 0.0 for axis in (x, y)])
    pitch = float(max(size.max() / VERTICES, np.sqrt(size.prod() / max(known.sum(), 1)))) or 1.0
    mesh = _interpolated(x, y, z, pitch)
    span = float(np.nanmax(mesh.z) - np.nanmin(mesh.z)) if np.isfinite(mesh.z).any() else 0.0
    return {
        "nx": mesh.z.shape[1],
        "ny": mesh.z.shape[0],
        "x0": round(mesh.x0, 6),
        "y0": round(mesh.y0, 6),
        "dx": round(pitch, 9),
        "dy": round(pitch, 9),
        "z": _base64(mesh.z),
        "exaggeration": round(0.25 * size.max() / span, 3) if span > 0 else 1.0,
        "label": "z",
        "layers": [
            _layer(name, *layer, _on(mesh, _interpolated(x, y, layer[0], pitch)))
            for name, layer in layers.items()
        ],
    }


def _interpolated(x: Floats, y: Floats, values: Floats, pitch: float) -> Grid:
    """Values of points x, y (H, W), NaN where unknown, at the multiples of the pitch."""
    known = np.isfinite(values)
    if not known.any():
        nothing = np.full((1, 1), np.nan)
        return Grid(nothing, nothing, x0=0.0, y0=0.0, pitch=pitch)
    flags = np.where(known, 0, 1).astype(np.uint16)
    return HeightMap(x, y, np.asarray(values, np.float64), np.zeros(known.shape), flags).resample(pitch)


def _on(mesh: Grid, layer: Grid) -> Floats:
    """A layer's values at the vertices of a mesh of the same pitch, NaN beyond the layer."""
    shape = mesh.z.shape
    values = np.full(shape, np.nan)
    row = np.rint((layer.y - mesh.y0) / mesh.pitch).astype(int)
    col = np.rint((layer.x - mesh.x0) / mesh.pitch).astype(int)
    rows, cols = (row >= 0) & (row < shape[0]), (col >= 0) & (col < shape[1])
    values[np.ix_(row[rows], col[cols])] = layer.z[np.ix_(rows, cols)]
    return values


def _layer(
    name: str, values: Floats, unit: str, colours: str, symmetric: bool, at_vertices: Floats
) -> dict[str, Any]:
    low, high = robust_limits(values, 0.995 if symmetric else 0.9999, symmetric)
    lut = np.round(matplotlib.colormaps[colours](np.linspace(0, 1, 256))[:, :3] * 255).astype(np.uint8)
    return {
        "name": name,
        "unit": unit,
        "low": low,
        "high": high,
        "data": _base64(np.nan_to_num(at_vertices, nan=low)),
        "lut": base64.b64encode(lut.tobytes()).decode("ascii"),
    }


def _base64(values: Floats) -> str:
    return base64.b64encode(np.ascontiguousarray(values, dtype="<f4").tobytes()).decode("ascii")
