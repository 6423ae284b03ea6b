"""reconstruct(): Correspondence + Scene -> HeightMap."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy.ndimage
from numpy.typing import NDArray

from optolever.decode import Correspondence, Flag
from optolever.errors import InputError
from optolever.scene import Scene

from .anchors import Anchors, Samples, anchor_samples
from .geometry import RayField, pattern_plane, ray_field
from .heightmap import Diagnostics, HeightFlag, HeightMap
from .measured import Measured
from .newton import Options, State, coarse_start, solve
from .outliers import curl_scale, curl_score, curl_suspects
from .paper import SeriesName
from .paper_scene import reconstruct_paper
from .pinning import anchor_rows
from .uncertainty import unknown_variance

__all__ = ["method_names", "reconstruct"]

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]
Labels = NDArray[np.int32]

_METHODS = {"coupled": True, "fixed-point": False}
PAPER_METHODS: dict[str, SeriesName] = {"paper": "mean", "paper-rises": "rises", "paper-drops": "drops"}
_CURL_LIMIT = 8.0  # standard deviations
_FIXED_POINT_STEPS = 60


def method_names() -> tuple[str, ...]:
    """Names that `reconstruct` takes as method."""
    return (*_METHODS, *PAPER_METHODS)


def reconstruct(
    correspondence: Correspondence,
    scene: Scene,
    method: str = "coupled",
    anchor: Anchors = None,
    mask: Mask | None = None,
    start: HeightMap | None = None,
) -> HeightMap:
    """The mirror behind a correspondence.

    method: 'coupled' (Newton with an integrating factor), 'fixed-point' (slow, a cross-check), or the paper's
    recursion 'paper', 'paper-rises', 'paper-drops' (see `reconstruct_paper`; no anchor, no sigma).
    anchor: what settles the free mode: 'edge' (default: the camera-side edge x = L0 rests), a point (x, y, z)
    in mm,
    or anchors of `anchors`. mask (H, W): pixels to use, among those without a flag. start: a height map of
    the same scene to start from.
    Raises InputError if the arrays do not fit the scene, no pixel is left, or no anchor can be used.
    """
    if method in PAPER_METHODS:
        return reconstruct_paper(correspondence, scene, series=PAPER_METHODS[method])
    if method not in _METHODS:
        raise InputError(f"method = {method!r}: unknown, must be one of {', '.join(method_names())}")
    rays = ray_field(scene.camera)
    valid = _valid(correspondence, rays, mask)
    samples = anchor_samples(anchor, scene, rays, valid)
    window = _Window.around(valid)
    data = window.measured(correspondence, rays, pattern_plane(scene), valid)
    local = samples.window(window.rows.start, window.cols.start)
    if _rows_rule(data):
        data, local, turned = _transposed(data), local.transposed(), True
    else:
        turned = False
    data, labels, lost = _anchored(data, local)
    options = Options() if _METHODS[method] else Options(newton=False, max_steps=_FIXED_POINT_STEPS)
    first = coarse_start(data, local, labels, options)
    state = solve(data, local, labels, first, options)
    return _height_map(correspondence, rays, window, data, labels, state, turned, valid, lost, method)


@dataclass(frozen=True, slots=True)
class _Window:
    """The part of the image that holds valid pixels."""

    rows: slice
    cols: slice

    @classmethod
    def around(cls, valid: Mask) -> "_Window":
        rows, cols = (np.flatnonzero(valid.any(axis=axis)) for axis in (1, 0))
        return cls(slice(int(rows[0]), int(rows[-1]) + 1), slice(int(cols[0]), int(cols[-1]) + 1))

    def measured(self, c: Correspondence, rays: RayField, plane: Floats, valid: Mask) -> Measured:
        u, v, sigma_u, sigma_v = (
            np.ascontiguousarray(part[self.rows, self.cols], dtype=np.float64)
            for part in (c.u, c.v, c.sigma_u, c.sigma_v)
        )
        inside = np.ascontiguousarray(valid[self.rows, self.cols])
        return Measured(rays.cropped(self.rows, self.cols), plane, u, v, sigma_u, sigma_v, inside)


def _valid(c: Correspondence, rays: RayField, mask: Mask | None) -> Mask:
    """Pixels to solve for; InputError where the input makes no sense."""
    if c.u.shape != rays.shape:
        raise InputError(
            f"correspondence: {c.u.shape[0]} x {c.u.shape[1]} pixels, the scene's camera has "
            f"{rays.shape[0]} x {rays.shape[1]}"
        )
    valid = c.good
    if mask is not None:
        if np.shape(mask) != rays.shape:
            raise InputError(f"mask: shape {np.shape(mask)}, must be {rays.shape} as the camera")
        valid = valid & np.asarray(mask, dtype=np.bool_)
    if not valid.any():
        raise InputError("mask: no pixel is left to reconstruct (all are flagged or masked)")
    for name in ("u", "v"):
        if not np.isfinite(getattr(c, name)[valid]).any():
            raise InputError(f"correspondence: {name} is NaN in every valid pixel; both axes must be encoded")
    valid = valid & np.isfinite(c.u) & np.isfinite(c.v)
    for name in ("sigma_u", "sigma_v"):
        sigma = getattr(c, name)
        wrong = valid & ~(np.isfinite(sigma) & (sigma >= 0))
        if wrong.any():
            row, col = np.argwhere(wrong)[0]
            raise InputError(
                f"correspondence: {name} = {sigma[row, col]} at pixel ({row}, {col}), which has no flag; "
                "must be finite and at least 0"
            )
    if not valid.any():
        raise InputError("correspondence: no pixel has both u and v")
    return valid


def _rows_rule(data: Measured) -> bool:
    """True if the slopes' variance depends on the row rather than on the column."""
    step = max(1, min(data.mask.shape) // 64)
    coarse = data.strided(step)
    variance = coarse.variances(coarse.rest())[0]
    with np.errstate(divide="ignore", invalid="ignore"):
        values = np.where(coarse.mask, np.log(variance), np.nan)
    spreads = []
    for axis in (0, 1):
        count = np.isfinite(values).sum(axis=axis)
        total = np.nansum(np.where(np.isfinite(values), values, np.nan), axis=axis)
        spreads.append(float(np.var((total / np.maximum(count, 1))[count > 0])))
    return spreads[1] > 4.0 * spreads[0] + 1e-3


def _transposed(data: Measured) -> Measured:
    names = ("u", "v", "sigma_u", "sigma_v", "mask")
    turned: dict[str, Any] = {name: np.ascontiguousarray(getattr(data, name).T) for name in names}
    return replace(data, rays=data.rays.transposed(), **turned)


def _anchored(data: Measured, samples: Samples) -> tuple[Measured, Labels, int]:
    """The measurement without components that no anchor reaches, its labels,
    and how many pixels that costs.
    """
    if data.mask.all():
        return data, np.ones(data.mask.shape, dtype=np.int32), 0
    labels = scipy.ndimage.label(data.mask)[0].astype(np.int32)
    reached = np.unique(anchor_rows(samples, data, labels).component)
    if reached.size == 0:
        raise InputError("anchor: no valid pixel within 3 pixels of any anchor")
    renumber = np.zeros(int(labels.max()) + 1, dtype=np.int32)
    renumber[reached] = np.arange(1, reached.size + 1)
    labels = renumber[labels]
    kept = labels > 0
    lost = int(np.count_nonzero(data.mask)) - int(np.count_nonzero(kept))
    if lost:
        data = replace(data, mask=kept)
    return data, labels, lost


def _height_map(
    c: Correspondence,
    rays: RayField,
    window: _Window,
    data: Measured,
    labels: Labels,
    state: State,
    turned: bool,
    valid: Mask,
    lost: int,
    method: str,
) -> HeightMap:
    p, q = data.slopes(state.w)[:2]
    score = curl_score(p, q, *state.variances, data.mask)
    scale = curl_scale(score)
    suspects = curl_suspects(score, _CURL_LIMIT * max(1.0, scale if np.isfinite(scale) else 1.0)) & data.mask
    sigma = np.sqrt(unknown_variance(state, labels))
    distance = data.distance(state.w)
    if data.rays.logarithmic:
        sigma = sigma * distance
    unreached = ~data.mask
    parts = [distance, sigma, suspects, unreached]
    if turned:
        parts = [np.ascontiguousarray(part.T) for part in parts]
    distance, sigma, suspects, unreached = parts
    shape = rays.shape
    place = (window.rows, window.cols)
    flags = np.asarray(c.flags, dtype=np.uint16).copy()
    flags[~valid & (flags == 0)] |= np.uint16(Flag.INVALID)
    inner = flags[place]
    inner[unreached & valid[place]] |= np.uint16(HeightFlag.NO_ANCHOR)
    inner[suspects] |= np.uint16(HeightFlag.CURL)
    if not state.converged:
        inner[~unreached] |= np.uint16(HeightFlag.NOT_CONVERGED)
    t = np.full(shape, np.nan)
    t[place] = np.where(unreached, np.nan, distance)
    o, d = rays.inner_origins, rays.inner_directions
    deviation = np.full(shape, np.nan)
    deviation[place] = np.where(unreached, np.nan, sigma)
    edges = 2 * int(np.count_nonzero(data.mask))
    diagnostics = Diagnostics(
        method=method,
        converged=state.converged,
        steps=state.steps,
        iterations=state.iterations,
        defect=float(np.sqrt(state.energy / edges)),
        curl=scale if np.isfinite(scale) else None,
        components=int(labels.max()),
        lost=lost,
        solver=type(state.problem).__name__,
    )
    return HeightMap(
        o[0] + t * d[0], o[1] + t * d[1], o[2] + t * d[2], deviation * np.abs(d[2]), flags, diagnostics
    )
