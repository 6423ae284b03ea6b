"""Maps and charts of a measurement as data for report/charts.js, and the surface for report/viewer.js.

A map is a set of layers on one grid: samples of single pixels, never averages, so that a number under the
pointer equals that of the data file. The grid holds at most CELLS samples, and all layers together SAMPLES.
"""

import base64
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import matplotlib
import numpy as np
from numpy.typing import NDArray

from optolever.quantities import length_unit
from optolever.reconstruct import Grid, HeightMap

from .arrays import Floats, Mask
from .images import MirrorGrid, robust_limits, thin

__all__ = [
    "CELLS",
    "VERTICES",
    "Layer",
    "camera_map",
    "chart",
    "histogram",
    "mirror_map",
    "reliability",
    "scores",
    "surface_data",
]

CELLS, SAMPLES = 500_000, 800_000  # of a map; of all its layers together
VERTICES = 150  # of the surface, on the longer side
BINS = 12
MOST = 400_000  # samples that enter a chart; the numbers on the page use them all
#: Of pixels: errors and their sigmas, (n,) each.
Scores: TypeAlias = tuple[NDArray[np.floating[Any]], NDArray[np.floating[Any]]]
#: Content of a JSON object.
Data: TypeAlias = dict[str, Any]


@dataclass(frozen=True, slots=True, eq=False)
class Layer:
    """One map: name, values (H, W) of camera pixels, NaN where unknown, their unit and colour map.

    symmetric: colours about zero; sigma: name of the layer of its standard deviations; true: of the truth.
    factor: on the values, for a unit that reads well; digits: significant ones under the pointer.
    """

    name: str
    values: NDArray[np.floating[Any]]
    unit: str
    colours: str = "viridis"
    symmetric: bool = False
    sigma: str = ""
    true: str = ""
    factor: float = 1.0
    digits: int = 6

    def data(self, sampled: NDArray[np.floating[Any]]) -> Data:
        """With the samples on a grid, (rows, cols) of its values."""
        share = 0.9999 if self.colours == "viridis" else 0.995
        low, high = robust_limits(self.values, share, self.symmetric)
        return {
            "name": self.name,
            "unit": self.unit,
            "low": self.factor * low,
            "high": self.factor * high,
            "digits": self.digits,
            "colours": self.colours,
            "sigma": self.sigma,
            "true": self.true,
            "data": _base64(self.factor * sampled),
        }


def length_layer(
    name: str, values: Floats, colours: str = "viridis", symmetric: bool = False, **more: Any
) -> Layer:
    """Of lengths (mm), in the unit in which the largest reads well."""
    low, high = robust_limits(values, 0.9999, symmetric)
    factor, unit = length_unit(max(abs(low), abs(high)) if np.isfinite(values).any() else 1.0)
    return Layer(name, values, unit, colours, symmetric, factor=factor, **more)


def mirror_map(x: Floats, y: Floats, layers: Sequence[Layer], samples: int = SAMPLES) -> Data:
    """Layers over the mirror, x, y (H, W) in mm, NaN where unknown; with the camera pixel of every sample."""
    grid = MirrorGrid.around(x, y, _side(x, y, min(CELLS, samples // (len(layers) + 1))))
    rows, cols = grid.pixel.shape
    pixel = np.where(
        grid.pixel < 0, -1, thin(np.arange(x.size).reshape(x.shape), 2 * grid.side).ravel()[grid.pixel]
    )
    return {
        "x0": grid.x0, "y0": grid.y0, "dx": grid.pitch, "dy": grid.pitch, "nx": cols, "ny": rows,
        "x": "x [mm]", "y": "y [mm]", "down": False, "cols": x.shape[1],
        "pixel": base64.b64encode(pixel.astype("<i4").tobytes()).decode("ascii"),
        "layers": [layer.data(grid.place(layer.values)) for layer in layers],
        "luts": _luts(layers),
    }  # fmt: skip


def camera_map(
    layers: Sequence[Layer], flags: NDArray[np.uint8], colours: Sequence[tuple[str, str]], side: int = 220
) -> Data:
    """Layers as the camera sees them, row 0 on top; flags (H, W): place of each pixel in the names and
    colours of its reasons."""
    shape = flags.shape
    step = max(1, -(-max(shape) // side))
    small = thin(flags, side)
    pixel = thin(np.arange(flags.size).reshape(shape), side)
    categories = {"name": "flags", "unit": "", "low": 0, "high": 255, "digits": 0, "colours": "", "sigma": ""}
    return {
        "x0": step // 2 - 0.5 * step, "y0": step // 2 - 0.5 * step, "dx": step, "dy": step,
        "nx": small.shape[1], "ny": small.shape[0],
        "x": "camera column [px]", "y": "camera row [px]", "down": True, "cols": shape[1],
        "pixel": base64.b64encode(pixel.astype("<i4").tobytes()).decode("ascii"),
        "layers": [
            *(layer.data(thin(layer.values, side)) for layer in layers),
            {**categories, "true": "", "data": _base64(small), "categories": list(colours)},
        ],
        "luts": _luts(layers),
    }  # fmt: skip


def _side(x: Floats, y: Floats, cells: int) -> int:
    """Cells on the longer side of a grid of that many."""
    known = np.isfinite(x) & np.isfinite(y)
    if not known.any():
        return 1
    size = np.array([np.ptp(part[known]) for part in (x, y)])
    return max(1, int(np.sqrt(cells * size.max() / max(size.min(), 1e-9 * size.max(), 1e-30))))


def _luts(layers: Sequence[Layer]) -> dict[str, str]:
    """256 colours of every colour map that occurs."""
    return {name: _lut(name) for name in sorted({layer.colours for layer in layers})}


def _lut(name: str) -> str:
    lut = np.round(matplotlib.colormaps[name](np.linspace(0, 1, 256))[:, :3] * 255).astype(np.uint8)
    return base64.b64encode(lut.tobytes()).decode("ascii")


def chart(
    x: NDArray[Any], lines: dict[str, tuple[str, NDArray[Any]]], axes: tuple[str, str], **more: Any
) -> Data:
    """A chart: x (n,), name -> (kind: line, points or bars; values (n,), NaN: none) and both axes' names.

    more: title, log (both axes), names (n,) of places in place of numbers, range of x, and of y.
    """
    plain = [{"name": name, "kind": kind, "values": _plain(values)} for name, (kind, values) in lines.items()]
    return {"x": _plain(x), "series": plain, "axes": list(axes), **more}


def _plain(values: NDArray[Any]) -> list[float | None]:
    return [float(f"{value:.6g}") if np.isfinite(value) else None for value in np.asarray(values).tolist()]


def histogram(name: str, found: Scores) -> Data:
    """Density of error over sigma beside the unit normal one."""
    edges = np.linspace(-5, 5, 81)
    error, sigma = found
    middle = 0.5 * (edges[1:] + edges[:-1])
    count, _ = np.histogram(np.clip(error / sigma, -5, 5), edges)
    density = count / max(count.sum(), 1) / (edges[1] - edges[0])
    normal = np.exp(-(middle**2) / 2) / np.sqrt(2 * np.pi)
    series = {"density": ("bars", density), "unit normal": ("line", normal)}
    return chart(middle, series, ("error / sigma", "density"), title=name)


def reliability_chart(name: str, found: Scores, unit: str) -> Data:
    """Measured rms error against predicted sigma, in bins of sigma; on the line the error bars are true."""
    predicted, measured = reliability(*found) if found[0].size else (np.array([1.0]), np.array([np.nan]))
    both = np.concatenate([predicted, measured[measured > 0]])
    span = float(np.nanmin(both)) / 1.5, float(np.nanmax(both)) * 1.5
    x = np.concatenate([[span[0]], predicted, [span[1]]])
    seen = np.concatenate([[np.nan], measured, [np.nan]])
    series = {"measured": ("points", seen), "predicted": ("line", x)}
    axes = f"predicted sigma [{unit}]", f"rms error [{unit}]"
    return chart(x, series, axes, title=name, log=True, range=span)


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
    return {
        "name": name,
        "unit": unit,
        "low": low,
        "high": high,
        "data": _base64(np.nan_to_num(at_vertices, nan=low)),
        "lut": _lut(colours),
    }


def _base64(values: NDArray[Any]) -> str:
    return base64.b64encode(np.ascontiguousarray(values, dtype="<f4").tobytes()).decode("ascii")
