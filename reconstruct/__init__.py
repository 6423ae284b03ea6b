"""reconstruct: Correspondence + Scene -> HeightMap, dense, with an error bar on every pixel.

| file | holds |
|---|---|
| `coupled.py` | reconstruct(): the chain from measurement to HeightMap |
| `stream.py` | HeightStream: one chord step a frame |
| `arrays.py` | names of arrays by what they hold |
| `problem.py`, `result.py` | checks, window, orientation, components; the solved grid as a HeightMap |
| `calibration.py` | a rest capture as reference |
| `coarse_modes.py` | smooth maps on every step-th pixel, and back |
| `rig.py` | modes by the errors of the rig; whether these explain the slopes |
| `references.py` | errors in common with maps of the same rest capture or anchor |
| `rig_effects.py` | errors beside the scene's numbers: cover glass, sag, gauge |
| `hypotheses.py` | mistakes in a description, tried one by one |
| `motion.py`, `motion_fields.py` | the rig's motion between rest and press; its fields |
| `budget.py` | the uncertainty of a height, a depth, a difference, by its sources |
| `exact.py` | the correspondence that a perfect decoder would give |
| `predicted.py` | what a rig would measure: its sigma at rest and of a dent |
| `circulation.py` | how slopes contradict each other: by noise or more, which sigma then holds |
| `sofast.py` | a SOFAST measurement on its rig's flat pattern |
| `holes.py`, `gaps.py` | small holes bridged; what is in doubt of the edges across them |
| `geometry.py`, `measured.py` | rays of the camera as arrays; a pixel grid with its measurement |
| `equations.py` | slopes of the mirror per pixel, in closed form, and their variances |
| `edges.py` | increments along pixel edges, weights, and the operators on them |
| `poisson.py`, `linear.py` | weighted Poisson by columns (DCT + tridiagonal); choice of the solver |
| `masked.py`, `multigrid.py` | any mask, any weights: conjugate gradients; their preconditioner |
| `multigrid_kernels.py` | its kernels |
| `alternatives.py`, `reweighting.py` | sparse factorisation and marching; robust reweighting |
| `newton.py` | Newton's method with an integrating factor |
| `anchors.py`, `gauge.py` | what is known of the mirror; from there to every component's free constant |
| `null_space.py` | what no slope measurement sees |
| `uncertainty.py`, `monte_carlo.py` | variance of the height: closed form of a rectangle, drawn noise |
| `shared_noise.py` | variance of the height by noise that rows, columns or whole frames share |
| `discontinuities.py` | edges whose increment is in doubt: cusps, ridges, rims, wrong pixels |
| `islands.py` | what those and missing pixels part from the anchors |
| `rounding.py` | errors of discrete codes, which neighbouring pixels share |
| `curl.py` | wrong pixels, by the curl of the slopes |
| `integrate.py`, `integrators.py` | plain gradient fields: integrate(), its family of solvers |
| `quadrilateral.py` | the same for pixels that lie anywhere |
| `rectangle.py` | the same on a rectangle, at the price of its two cosine transforms |
| `heightmap.py`, `resampling.py` | HeightMap; its regular grid, with conserved sigma |
| `export.py`, `x3p.py` | TIFF, PLY, STL, XYZ, SDF, Zygo DAT; X3P (ISO 25178-72); only written |
| `slope_map.py`, `curvature.py` | slopes from the normals, curvature from the slopes, with sigma |
| `contact/` | contacts: depth, area, volume, centroid, and the edge of what presses on the mirror |
| `paper.py`, `paper_equations.py`, `paper_scene.py` | the paper's recursion, by equations and on a scene |
"""

from optolever.arguments import check_face

from .anchors import Anchor, DistanceAnchor, EdgeAnchor, PixelAnchor, PointAnchor
from .budget import ANCHOR, NOISE, TOTAL, budget, free_mode_of
from .contact import Contact, contacts
from .coupled import method_names, reconstruct
from .curvature import CurvatureMap, curvature_map
from .exact import exact_correspondence
from .heightmap import HEIGHT_FORMATS, Diagnostics, HeightFlag, HeightMap
from .integrate import Integral, integrate, integrator_names
from .motion import Motion, fit_motion, same_capture
from .motion_fields import MotionPrior
from .null_space import null_space
from .paper import PaperGeometry, PaperResult, Profile, SeriesName, recursion, series
from .paper_equations import (
    angle_increment,
    capture_position,
    height_increment,
    mirror_position,
    pattern_angle,
    pattern_position,
    slope_angle,
)
from .paper_scene import (
    capture_positions,
    pattern_positions,
    prism_geometry,
    reconstruct_paper,
    row_recursion,
)
from .predicted import (
    PREDICTED_DEPTH,
    PREDICTED_NOISE,
    depth_sigma_against_rest,
    predicted_budget,
    predicted_maps,
    sigma_at_rest,
)
from .resampling import GRID_FORMATS, Grid
from .slope_map import SlopeMap, slope_map
from .sofast import on_rig
from .stream import HeightStream

free_mode = null_space  # its name before

__all__ = [
    "ANCHOR",
    "GRID_FORMATS",
    "HEIGHT_FORMATS",
    "NOISE",
    "PREDICTED_DEPTH",
    "PREDICTED_NOISE",
    "TOTAL",
    "Anchor",
    "Contact",
    "CurvatureMap",
    "Diagnostics",
    "DistanceAnchor",
    "EdgeAnchor",
    "Grid",
    "HeightFlag",
    "HeightMap",
    "HeightStream",
    "Integral",
    "Motion",
    "MotionPrior",
    "PaperGeometry",
    "PaperResult",
    "PixelAnchor",
    "PointAnchor",
    "Profile",
    "SeriesName",
    "SlopeMap",
    "angle_increment",
    "budget",
    "capture_position",
    "capture_positions",
    "contacts",
    "curvature_map",
    "depth_sigma_against_rest",
    "exact_correspondence",
    "fit_motion",
    "free_mode",
    "free_mode_of",
    "height_increment",
    "integrate",
    "integrator_names",
    "method_names",
    "mirror_position",
    "null_space",
    "on_rig",
    "pattern_angle",
    "pattern_position",
    "pattern_positions",
    "predicted_budget",
    "predicted_maps",
    "prism_geometry",
    "reconstruct",
    "reconstruct_paper",
    "recursion",
    "row_recursion",
    "same_capture",
    "series",
    "sigma_at_rest",
    "slope_angle",
    "slope_map",
]

check_face(__name__)
