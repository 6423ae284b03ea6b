"""reconstruct: Correspondence + Scene -> HeightMap, dense, with an error bar on every pixel.

| room or file | holds |
|---|---|
| `coupled.py` | reconstruct(): the chain from measurement to HeightMap |
| `problem.py`, `result.py` | checks, window, components, the first solution; it as a HeightMap |
| `geometry.py` | rays of the camera |
| `measured.py` | a measured grid, and its slopes in closed form |
| `heightmap.py` | HeightMap |
| `exact.py` | the correspondence that a perfect decoder would give |
| `solver/` | the height that has these slopes |
| `judgement/` | which slopes and edges are in doubt; the tests of a map |
| `uncertainty/` | variance of the height by noise, and its budget |
| `rig/` | errors of the rig in the height; a rest capture as reference; explain(): mistakes in a scene |
| `integrate.py` | integrate(): plain gradient fields |
| `outputs/` | a regular grid, slopes, curvature, files |
| `load.py` | sag and motion taken off a map less rest; its contacts |
"""

from optolever.contact import Contact

from .coupled import reconstruct
from .exact import exact_correspondence
from .heightmap import HEIGHT_FORMATS, Diagnostics, HeightFlag, HeightMap
from .integrate import Integral, integrate
from .load import contacts
from .outputs.curvature import CurvatureMap, curvature_map
from .outputs.resampling import GRID_FORMATS, Grid, natural_pitch
from .outputs.slope_map import SlopeMap, slope_map, with_slope_noise
from .rig.hypotheses import explain
from .solver.anchors import Anchor, EdgeAnchor, PixelAnchor, PointAnchor
from .solver.poisson import ColumnPoisson
from .uncertainty.budget import TOTAL, budget
from .uncertainty.null_space import null_space
from .uncertainty.sources import NOISE

__all__ = [
    "GRID_FORMATS", "HEIGHT_FORMATS", "NOISE", "TOTAL", "Anchor", "ColumnPoisson", "Contact",
    "CurvatureMap", "Diagnostics", "EdgeAnchor", "Grid", "HeightFlag", "HeightMap", "Integral",
    "PixelAnchor", "PointAnchor", "SlopeMap", "budget", "contacts", "curvature_map",
    "exact_correspondence", "explain", "integrate", "natural_pitch", "null_space",
    "reconstruct", "slope_map", "with_slope_noise",
]  # fmt: skip
