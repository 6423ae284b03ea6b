"""Pictures of maps: on the mirror in mm (x to the right, y up) and on the camera's pixels."""

from dataclasses import dataclass, replace

import numpy as np
from matplotlib.colors import ListedColormap
from numpy.typing import NDArray
from scipy import ndimage

from .images import figure_uri, label_axes, new_figure, robust_limits, thin

__all__ = ["MirrorGrid", "Panel", "camera_figure", "flags_figure", "length_unit", "mirror_figure"]

Array = NDArray[np.float64]
CAMERA = "camera column [px]", "camera row [px]"
SIDE = 520  # samples on the longer side of a drawn map


@dataclass(frozen=True, slots=True)
class Panel:
    """One map of a figure: values, title, colour map, limits (None: robust ones) and the colour bar's
    label.
    """

    values: Array
    title: str
    label: str
    colours: str = "viridis"
    limits: tuple[float, float] | None = None


@dataclass(frozen=True, slots=True)
class MirrorGrid:
    """A regular grid over the mirror (mm) and which camera pixel fell into which of its cells."""

    x0: float
    y0: float
    pitch: float
    shape: tuple[int, int]
    row: NDArray[np.intp]
    col: NDArray[np.intp]
    inside: NDArray[np.bool_]

    @classmethod
    def around(cls, x: Array, y: Array, side: int = SIDE) -> "MirrorGrid":
        """A grid of at most `side` cells over the finite points x, y (any shape), never finer than they
        are.
        """
        inside = np.isfinite(x) & np.isfinite(y)
        if not inside.any():
            return cls(0.0, 0.0, 1.0, (1, 1), np.zeros(0, np.intp), np.zeros(0, np.intp), inside)
        xs, ys = x[inside], y[inside]
        spans = float(np.ptp(xs)), float(np.ptp(ys))
        spacing = 1.15 * np.sqrt(max(spans[0] * spans[1], 1e-12) / inside.sum())
        pitch = max(max(spans) / side, spacing)
        x0, y0 = float(xs.min()), float(ys.min())
        shape = int(spans[1] / pitch) + 1, int(spans[0] / pitch) + 1
        row, col = ((ys - y0) / pitch).astype(np.intp), ((xs - x0) / pitch).astype(np.intp)
        return cls(x0, y0, pitch, shape, row, col, inside)

    @property
    def extent(self) -> tuple[float, float, float, float]:
        """Left, right, bottom, top in mm."""
        return (
            self.x0,
            self.x0 + self.shape[1] * self.pitch,
            self.y0,
            self.y0 + self.shape[0] * self.pitch,
        )

    def place(self, values: Array) -> Array:
        """Values of camera pixels on the grid: one sample per cell, single holes closed by a neighbour."""
        grid = np.full(self.shape, np.nan)
        picked = np.asarray(values, dtype=np.float64)[self.inside]
        finite = np.isfinite(picked)
        grid[self.row[finite], self.col[finite]] = picked[finite]
        missing = np.isnan(grid)
        if not missing.any() or missing.all():
            return grid
        distance, nearest = ndimage.distance_transform_edt(missing, return_indices=True)
        return np.where(distance <= 1, grid[tuple(nearest)], np.nan)


def length_unit(size: float) -> tuple[float, str]:
    """Factor and name of the unit in which a length given in mm reads well."""
    if abs(size) >= 0.1 or size == 0 or not np.isfinite(size):
        return 1.0, "mm"
    return (1e3, "µm") if abs(size) >= 1e-4 else (1e6, "nm")


def mirror_figure(panels: list[Panel], grid: MirrorGrid) -> str:
    """Maps of the mirror side by side, axes in mm; values are already on the grid."""
    left, right, bottom, top = grid.extent
    return _draw(panels, grid.extent, ("x [mm]", "y [mm]"), (top - bottom) / max(right - left, 1e-9), "lower")


def camera_figure(panels: list[Panel]) -> str:
    """Maps on the camera's pixels as the camera sees them: row 0 on top; samples of the pixels."""
    rows, cols = panels[0].values.shape
    small = [replace(panel, values=thin(panel.values, SIDE)) for panel in panels]
    return _draw(small, (-0.5, cols - 0.5, rows - 0.5, -0.5), CAMERA, rows / cols, "upper")


def flags_figure(index: NDArray[np.integer], colours: list[str]) -> str:
    """A map of categories on the camera's pixels; index 0.. into colours; samples of the pixels."""
    rows, cols = index.shape
    figure = new_figure(6.4, min(9.0, 0.5 + 5.6 * rows / cols))
    axes = figure.subplots()
    axes.imshow(
        thin(index, SIDE),
        cmap=ListedColormap(colours),
        vmin=-0.5,
        vmax=len(colours) - 0.5,
        extent=(-0.5, cols - 0.5, rows - 0.5, -0.5),
        interpolation="nearest",
    )
    label_axes(axes, *CAMERA, frame=True)
    return figure_uri(figure)


def _draw(
    panels: list[Panel],
    extent: tuple[float, float, float, float],
    names: tuple[str, str],
    ratio: float,
    origin: str,
) -> str:
    columns = min(len(panels), 2)
    lines = -(-len(panels) // columns)
    width = 5.6 * columns if columns > 1 else 6.4
    beside = 2.0 if columns > 1 else 1.3  # inches for ticks, labels and colour bar
    figure = new_figure(width, lines * min(7.0, 0.55 + (width / columns - beside) * ratio))
    for axes, panel in zip(figure.subplots(lines, columns, squeeze=False).flat, panels, strict=False):
        low, high = panel.limits or robust_limits(panel.values)
        image = axes.imshow(
            panel.values,
            cmap=panel.colours,
            vmin=low,
            vmax=high,
            extent=extent,
            origin=origin,
            interpolation="nearest",
        )
        axes.set_facecolor("#d9dde2")
        label_axes(axes, *names, panel.title, frame=True)
        bar = figure.colorbar(image, ax=axes, fraction=0.046, pad=0.02)
        bar.set_label(panel.label, fontsize=9)
        bar.ax.tick_params(labelsize=8)
    return figure_uri(figure)
