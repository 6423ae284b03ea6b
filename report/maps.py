"""Maps and charts of a measurement as data for report/charts.js, and the surface for report/viewer.js.

A map is a set of layers on one grid: samples of single pixels, never averages, so that a number under the
pointer equals that of the data file. The grid holds at most CELLS samples, and all layers together SAMPLES.
"""

import base64
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from optolever.arrays import Floats
from optolever.quantities import length_unit
from optolever.reconstruct import HeightMap

from .flag_table import FlagRow, flag_index

__all__ = [
    "VERTICES", "Data", "Layer", "MirrorGrid", "camera_map", "chart", "error_charts", "length_layer",
    "mirror_map", "reliability", "surface_data",
]  # fmt: skip

CELLS, SAMPLES = 500_000, 800_000  # of a map; of all its layers together
VERTICES = 150  # of the surface, on the longer side of the image
CAMERA = 220  # samples of a map of the camera's pixels, on the longer side
BINS = 12
MOST = 400_000  # samples that enter a chart, or a colour scale's limits
_OF_OPENCV = {"viridis": cv2.COLORMAP_VIRIDIS, "cividis": cv2.COLORMAP_CIVIDIS}
#: Colours between which others are interpolated. RdBu: Cynthia Brewer, colorbrewer2.org.
_KNOTS = {"RdBu_r": "053061 2166ac 4393c3 92c5de d1e5f0 f7f7f7 fddbc7 f4a582 d6604d b2182b 67001f"}
Values: TypeAlias = NDArray[np.floating[Any]]
#: Content of a JSON object.
Data: TypeAlias = dict[str, Any]


@dataclass(frozen=True, slots=True, eq=False)
class Layer:
    """One map: name, values (H, W) of camera pixels, NaN where unknown, their unit and colour map.

    symmetric: colours about zero; sigma: name of the layer of its standard deviations; true: of the truth;
    strip: of what a model leaves, shown below a profile. factor: on the values, for a unit that reads well;
    digits: significant ones under the pointer; share: of the values, that the colours distinguish (0: by the
    colour map); its data say whether values lie below or above them. Colours of sigma are logarithmic.
    """

    name: str
    values: Values
    unit: str
    colours: str = "viridis"
    symmetric: bool = False
    sigma: str = ""
    true: str = ""
    strip: str = ""
    factor: float = 1.0
    digits: int = 6
    share: float = 0.0

    def data(self, sampled: Values) -> Data:
        """With the samples on a grid, (rows, cols) of its values."""
        share = self.share or (0.9999 if self.colours == "viridis" else 0.995)
        low, high = robust_limits(self.values, share, self.symmetric)
        known = self.values[np.isfinite(self.values)]
        names = ("name", "unit", "digits", "colours", "sigma", "true", "strip")
        return {name: getattr(self, name) for name in names} | {
            "low": self.factor * low,
            "high": self.factor * high,
            "below": bool(np.any(known < low)),
            "above": bool(np.any(known > high)),
            "log": self.colours == "cividis" and low > 0,
            "data": _base64(self.factor * sampled),
        }


def length_layer(
    name: str, values: Floats, colours: str = "viridis", symmetric: bool = False, **more: Any
) -> Layer:
    """Of lengths (mm), in the unit in which the largest reads well."""
    low, high = robust_limits(values, 0.9999, symmetric)
    factor, unit = length_unit(max(abs(low), abs(high)) if np.isfinite(values).any() else 1.0)
    return Layer(name, values, unit, colours, symmetric, factor=factor, **more)


@dataclass(frozen=True, slots=True)
class MirrorGrid:
    """A regular grid over the mirror (mm): index of the pixel, among those thinned to twice `side`, that is
    nearest to the middle of each cell, -1 where none is near."""

    x0: float
    y0: float
    pitch: float
    pixel: NDArray[np.intp]
    side: int

    @classmethod
    def around(cls, x: Floats, y: Floats, side: int) -> "MirrorGrid":
        """A grid of at most `side` cells over the finite points x, y (H, W), never finer than they are."""
        points = np.column_stack([thin(x, 2 * side).ravel(), thin(y, 2 * side).ravel()])
        known = np.flatnonzero(np.isfinite(points).all(axis=1))
        if not known.size:
            return cls(0.0, 0.0, 1.0, np.full((1, 1), -1), side)
        low, size = points[known].min(axis=0), np.ptp(points[known], axis=0)
        pitch = float(max(size.max() / side, 1.15 * np.sqrt(max(size.prod(), 1e-12) / known.size)))
        cols, rows = (size / pitch).astype(int) + 1
        cells = np.stack(np.meshgrid(np.arange(cols), np.arange(rows)), axis=-1)
        away, nearest = cKDTree(points[known]).query(low + pitch * (cells + 0.5))
        return cls(float(low[0]), float(low[1]), pitch, np.where(away <= pitch, known[nearest], -1), side)

    def place(self, values: NDArray[Any], missing: float = np.nan) -> NDArray[Any]:
        """Values of camera pixels (H, W) on the grid: samples, never averages."""
        return np.where(self.pixel < 0, missing, thin(values, 2 * self.side).ravel()[self.pixel])


def mirror_map(x: Floats, y: Floats, layers: Sequence[Layer]) -> Data:
    """Layers over the mirror, x, y (H, W) in mm, NaN where unknown; with the camera pixel of every sample."""
    cells, known = min(CELLS, SAMPLES // (len(layers) + 1)), np.isfinite(x) & np.isfinite(y)
    size = np.array([np.ptp(part[known]) if known.any() else 1.0 for part in (x, y)])
    side = max(1, int(np.sqrt(cells * size.max() / max(size.min(), 1e-9 * size.max(), 1e-30))))
    grid = MirrorGrid.around(x, y, side)
    pixel = grid.place(np.arange(x.size).reshape(x.shape), -1)
    drawn = [layer.data(grid.place(layer.values)) for layer in layers]
    return _map(pixel, (grid.x0, grid.y0), grid.pitch, layers, drawn) | {
        "x": "x [mm]", "y": "y [mm]", "down": False, "cols": x.shape[1]
    }  # fmt: skip


def camera_map(flags: NDArray[np.integer], rows: Sequence[FlagRow]) -> Data:
    """Flags (H, W) as the camera sees them, row 0 on top: of each pixel its first reason among the rows."""
    step = max(1, -(-max(flags.shape) // CAMERA))
    pixel = thin(np.arange(flags.size).reshape(flags.shape), CAMERA)
    marked = [row for row in rows if row.bit >= 0]
    index = flag_index(thin(flags, CAMERA), [row.bit for row in marked])
    drawn = {"name": "flags", "unit": "", "low": 0, "high": 255, "digits": 0, "colours": "", "sigma": "",
             "true": "", "data": _base64(index), "log": False,
             "categories": [(row.name, row.colour) for row in marked]}  # fmt: skip
    start = step // 2 - 0.5 * step
    return _map(pixel, (start, start), step, (), [drawn]) | {
        "x": "camera column [px]", "y": "camera row [px]", "down": True, "cols": flags.shape[1]
    }  # fmt: skip


def _map(
    pixel: NDArray[Any], start: tuple[float, float], step: float, layers: Sequence[Layer], drawn: list[Data]
) -> Data:
    return {
        "x0": start[0], "y0": start[1], "dx": step, "dy": step,
        "nx": pixel.shape[1], "ny": pixel.shape[0],
        "pixel": base64.b64encode(pixel.astype("<i4").tobytes()).decode("ascii"),
        "layers": drawn,
        "luts": {name: _lut(name) for name in sorted({layer.colours for layer in layers})},
    }  # fmt: skip


def _lut(name: str) -> str:
    """256 colours (256, 3) of a colour map of that name in matplotlib, whose import takes .4 s."""
    if name in _OF_OPENCV:
        lut = cv2.applyColorMap(np.arange(256, dtype=np.uint8), _OF_OPENCV[name]).reshape(256, 3)[:, ::-1]
    else:
        knots = np.array([list(bytes.fromhex(colour)) for colour in _KNOTS[name].split()]).T
        place = np.linspace(0, knots.shape[1] - 1, 256)
        channels = [np.interp(place, np.arange(len(channel)), channel) for channel in knots]
        lut = np.stack(channels, axis=-1).round().astype(np.uint8)
    return base64.b64encode(lut.tobytes()).decode("ascii")


def _base64(values: NDArray[Any]) -> str:
    return base64.b64encode(np.ascontiguousarray(values, dtype="<f4").tobytes()).decode("ascii")


def chart(
    x: NDArray[Any], lines: Mapping[str, tuple[str, NDArray[Any]]], axes: tuple[str, str], **more: Any
) -> Data:
    """A chart: x (n,), name -> (kind: line, points or bars; values (n,), NaN: none) and both axes' names.

    more: title, log (both axes), names (n,) of places in place of numbers, range of x, and of y.
    """
    plain = [{"name": name, "kind": kind, "values": _plain(values)} for name, (kind, values) in lines.items()]
    return {"x": _plain(x), "series": plain, "axes": list(axes), **more}


def _plain(values: NDArray[Any]) -> list[float | None]:
    return [float(f"{value:.6g}") if np.isfinite(value) else None for value in np.asarray(values).tolist()]


def error_charts(name: str, error: Values, sigma: Values, unit: str) -> dict[str, Data]:
    """Charts by the id of their figure, of errors and their sigmas (n,): density of error over sigma with the
    unit normal one; measured rms error against predicted sigma, in bins of sigma."""
    use = np.isfinite(sigma) & (sigma > 0) & np.isfinite(error)
    step = max(1, -(-int(use.sum()) // MOST))
    error, sigma = error[use][::step], sigma[use][::step]
    edges = np.linspace(-5, 5, 81)
    middle = 0.5 * (edges[1:] + edges[:-1])
    count, _ = np.histogram(np.clip(error / sigma, -5, 5), edges)
    density = count / max(count.sum(), 1) / (edges[1] - edges[0])
    normal = np.exp(-(middle**2) / 2) / np.sqrt(2 * np.pi)
    densities = {"density": ("bars", density), "unit normal": ("line", normal)}
    predicted, measured = reliability(error, sigma) if error.size else (np.array([1.0]), np.array([np.nan]))
    both = np.concatenate([predicted, measured[measured > 0]])
    span = float(np.nanmin(both)) / 1.5, float(np.nanmax(both)) * 1.5
    x = np.concatenate([[span[0]], predicted, [span[1]]])
    points = np.concatenate([[np.nan], measured, [np.nan]])
    lines = {"measured": ("points", points), "predicted": ("line", x)}
    axes = f"predicted sigma [{unit}]", f"rms error [{unit}]"
    return {
        f"histogram-{name}": chart(middle, densities, ("error / sigma", "density"), title=name),
        f"reliability-{name}": chart(x, lines, axes, title=name, log=True, range=span),
    }


def reliability(error: Values, sigma: Values) -> tuple[Floats, Floats]:
    """Rms sigma and rms error in BINS bins of equally many pixels, sorted by sigma."""
    order = np.argsort(sigma, kind="stable")
    groups = [group for group in np.array_split(order, BINS) if group.size]
    predicted = np.array([np.sqrt(np.mean(sigma[group] ** 2)) for group in groups])
    measured = np.array([np.sqrt(np.mean(error[group] ** 2)) for group in groups])
    return predicted, measured


def surface_data(surface: HeightMap, name: str, signed: bool) -> Data:
    """Data of report/viewer.js: at most VERTICES good points of a map a side, samples of single pixels, in
    colours of the height, called `name`, and of sigma. signed: heights are about zero."""
    good = thin(surface.good & np.isfinite(surface.z), VERTICES)
    fields = (surface.x, surface.y, surface.z, surface.total_sigma)
    x, y, z, sigma = (np.where(good, thin(part, VERTICES), np.nan) for part in fields)
    sizes = [float(np.ptp(part[good])) if good.any() else 0.0 for part in (x, y, z)]
    side, span = max(sizes[:2]), sizes[2]
    colourings = (
        length_layer(name, z, "RdBu_r" if signed else "viridis", signed),
        length_layer("sigma", sigma, "cividis"),
    )
    return {
        "nx": z.shape[1],
        "ny": z.shape[0],
        "x": _base64(x),
        "y": _base64(y),
        "z": _base64(z),
        "exaggeration": round(0.25 * side / span, 3) if span > 0 else 1.0,
        "label": "z",
        "layers": [
            layer.data(np.nan_to_num(layer.values)) | {"lut": _lut(layer.colours)} for layer in colourings
        ],
    }


def thin(array: NDArray[Any], side: int) -> NDArray[Any]:
    """Every k-th row and column of an array, at most `side` of each: samples, never averages."""
    step = max(1, -(-max(array.shape[:2]) // side))
    return array[step // 2 :: step, step // 2 :: step]


def robust_limits(values: NDArray[Any], share: float = 0.995, symmetric: bool = False) -> tuple[float, float]:
    """Limits of a colour scale that hold this share of the finite values; (0, 1) of nothing."""
    finite = values[np.isfinite(values)]
    finite = finite[:: max(1, finite.size // MOST)]
    if not finite.size:
        return (-1.0, 1.0) if symmetric else (0.0, 1.0)
    if symmetric:
        limit = float(np.quantile(np.abs(finite), share)) or 1.0
        return -limit, limit
    low, high = (float(q) for q in np.quantile(finite, (1 - share, share)))
    return (low, high) if high > low else (low - 0.5, high + 0.5)
