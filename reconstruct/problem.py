"""From a Correspondence and a Scene to the grid that is solved, and its first solution: checks, window,
orientation, components; what cannot be solved is left out."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy.ndimage
from numpy.typing import NDArray

from optolever.arrays import Floats, Labels, Mask, Pair
from optolever.decode import Correspondence
from optolever.errors import InputError
from optolever.scene import Pattern, Scene

from .geometry import RayField, pattern_plane, ray_field
from .judgement.holes import bridged, small_holes
from .measured import Measured
from .solver.anchors import EDGE_REACH, Anchors, Samples, anchor_rows, anchor_samples
from .solver.newton import State, solve

__all__ = ["Problem", "first_solution", "on_pixels", "prepare"]

_LEAST = 2  # rows and columns of pixels
_LEAST_SIGMA = 1e-5  # pattern pixels
_NOISE = 5.0  # deviations that noise may lead beyond the pattern
#: Pixels of a component: with fewer, the way to an anchor has no estimate of the change of slope.
_FEWEST = 4


@dataclass(frozen=True, slots=True)
class Window:
    """The part of an image that holds valid pixels.

    rays, valid: of the full image (H, W); rows, cols: the part; data: that grid, to which the samples
    belong; variances: of the slopes with the mirror at rest; usual: see `Measured.singular`.
    """

    rays: RayField
    valid: Mask
    rows: slice
    cols: slice
    data: Measured
    samples: Samples
    variances: Pair
    usual: Floats

    def to_grid(self, image: NDArray[Any]) -> NDArray[Any]:
        """The grid's part of an array of the image (..., H, W)."""
        return np.ascontiguousarray(image[..., self.rows, self.cols])

    def rays_on_grid(self, rays: RayField) -> RayField:
        """The grid's part of rays of the image."""
        return rays.cropped(self.rows, self.cols)

    def to_image(self, grid: NDArray[Any], outside: Any) -> NDArray[Any]:
        """An array of the image (..., H, W) from one of the grid."""
        image = np.full((*grid.shape[:-2], *self.valid.shape), outside, dtype=grid.dtype)
        image[..., self.rows, self.cols] = grid
        return image


@dataclass(frozen=True, slots=True)
class Grid(Window):
    """Before any pixel is left out, holes bridged. seen, holes (rows, cols): measured pixels, and those
    between; hollow: pixels that cannot be solved with the mirror at rest."""

    seen: Mask
    holes: Mask
    hollow: Mask


@dataclass(frozen=True, slots=True)
class Problem(Window):
    """What is solved. labels: the grid's anchored components from 1 on; bridged: interpolated pixels, of
    small holes; lost: valid pixels without an anchor; singular (H, W): valid pixels of the image that cannot
    be solved (see `Measured.singular`); suspects (H, W): wrong pixels."""

    labels: Labels
    bridged: Mask
    lost: int
    singular: Mask
    suspects: Mask


def first_solution(
    correspondence: Correspondence, scene: Scene, anchor: Anchors = None, mask: Mask | None = None
) -> tuple[Problem, State]:
    """The problem and its solution, without a look at outliers and discontinuities.

    Pixels that cannot be solved with the mirror at rest are excluded.
    """
    problem = on_pixels(prepare(correspondence, scene, anchor, mask))
    data = problem.data
    state = solve(data, problem.samples, problem.labels, data.rest(), variances=problem.variances)
    hollow = problem.to_image(data.singular(state.w, usual=problem.usual)[0], False)
    return replace(problem, singular=problem.singular | (hollow & problem.valid)), state


def prepare(
    correspondence: Correspondence, scene: Scene, anchor: Anchors = None, mask: Mask | None = None
) -> Grid:
    """Everything up to the choice of pixels. Raises InputError where the input makes no sense or no anchor
    can be used.
    """
    size, camera = correspondence.u.shape, scene.camera
    if size != (camera.rows, camera.cols):
        raise InputError(
            f"correspondence: {size[0]} x {size[1]} pixels, the scene's camera has "
            f"{camera.rows} x {camera.cols}"
        )
    if min(size) < _LEAST:
        raise InputError(
            f"correspondence: {size[0]} x {size[1]} pixels, must be at least {_LEAST} x {_LEAST}: slopes are "
            "integrated along rows and columns; take a larger part of the image"
        )
    rays = ray_field(camera)
    valid = _valid(correspondence, rays, scene.pattern, mask)
    samples = anchor_samples(anchor, scene, rays, valid)
    rows, cols = (_extent(valid, axis) for axis in (1, 0))
    data = _window(correspondence, rays, pattern_plane(scene), valid, rows, cols)
    data = replace(data, shape=scene.pattern.shape)
    samples = samples.on_grid(rows, cols)
    holes = small_holes(data.mask)
    seen, data = data.mask, bridged(data, holes)
    rest = data.rest()
    variances = data.variances(rest)
    hollow, usual = data.singular(rest, variances)
    return Grid(rays, valid, rows, cols, data, samples, variances, usual, seen, holes, hollow)


def on_pixels(grid: Grid) -> Problem:
    """The problem on a grid without pixels that cannot be solved at rest. Raises InputError where no anchor
    reaches any other."""
    data, samples, hollow = grid.data, grid.samples, grid.hollow
    # after holes are bridged: across these none is
    data = replace(data, mask=data.mask & ~hollow)
    labels = _anchored_labels(data, samples)
    if not labels.any():
        raise InputError(
            f"anchor: no usable pixel (four in a row, unless it is on one) within {EDGE_REACH:g} pixels"
            f"{_nearest_usable(data, samples)}"
        )
    left_out = grid.to_image(hollow, False) & grid.valid
    lost = int(np.count_nonzero(grid.seen & ~hollow & (labels == 0)))
    down, along = (_extent(labels > 0, axis) for axis in (1, 0))
    if min(down.stop - down.start, along.stop - along.start) < _LEAST:
        down, along = (slice(0, size) for size in labels.shape)
    inner = down, along
    labels = np.ascontiguousarray(labels[inner])
    return Problem(
        grid.rays,
        grid.valid,
        _within(grid.rows, down),
        _within(grid.cols, along),
        _cropped(data, inner, labels > 0),
        samples.on_grid(down, along),
        (grid.variances[0][inner], grid.variances[1][inner]),
        grid.usual[inner],
        labels,
        (grid.holes & ~hollow)[inner],
        lost,
        left_out,
        np.zeros_like(grid.valid),
    )


def _within(outer: slice, inner: slice) -> slice:
    return slice(outer.start + inner.start, outer.start + inner.stop)


def _cropped(data: Measured, window: tuple[slice, slice], mask: Mask) -> Measured:
    """A window of it, with this mask."""
    if mask.shape == data.mask.shape:
        return replace(data, mask=mask)
    names = ("u", "v", "sigma_u", "sigma_v")
    parts: dict[str, Any] = {name: np.ascontiguousarray(getattr(data, name)[window]) for name in names}
    return replace(data, rays=data.rays.cropped(*window), mask=mask, **parts)


def _nearest_usable(data: Measured, samples: Samples) -> str:
    """Where the nearest anchor that can be used lies; nothing if no part of the grid is large enough."""
    labels = scipy.ndimage.label(data.mask)[0]
    large = np.bincount(labels.ravel()) >= _FEWEST
    large[0] = False
    row, col = np.nonzero(large[labels])
    known = np.isfinite(samples.row) & np.isfinite(samples.col)
    if not row.size or not known.any():
        return ""
    away = np.hypot(row - samples.row[known].mean(), col - samples.col[known].mean())
    x, y, _ = data.points_at_rest()[:, row[np.argmin(away)], col[np.argmin(away)]]
    return f"; the nearest is at ({x:.1f}, {y:.1f}) mm: reconstruct --anchor {x:.1f},{y:.1f},Z, Z its height"


def _extent(valid: Mask, axis: int) -> slice:
    at = np.flatnonzero(valid.any(axis=axis))
    return slice(int(at[0]), int(at[-1]) + 1)


def _window(
    c: Correspondence, rays: RayField, plane: Floats, valid: Mask, rows: slice, cols: slice
) -> Measured:
    inside = np.ascontiguousarray(valid[rows, cols])
    u, v, sigma_u, sigma_v = (  # what is flagged is no neighbour to compare with
        np.where(inside, part[rows, cols], np.nan).astype(np.float64)
        for part in (c.u, c.v, c.sigma_u, c.sigma_v)
    )
    for sigma in (sigma_u, sigma_v):  # exact data still carries the weights that the scene gives it
        np.maximum(sigma, _LEAST_SIGMA, out=sigma)
    return Measured(rays.cropped(rows, cols), plane, u, v, sigma_u, sigma_v, inside)


def _valid(c: Correspondence, rays: RayField, pattern: Pattern, mask: Mask | None) -> Mask:
    """Pixels to solve for: unflagged and on the pattern; InputError where the input makes no sense."""
    valid = c.good
    if mask is not None:
        if np.shape(mask) != rays.shape:
            raise InputError(f"mask: shape {np.shape(mask)}, must be {rays.shape} as the camera")
        valid = valid & np.asarray(mask, dtype=np.bool_)
    if not valid.any():
        raise InputError("mask: no pixel is left to reconstruct (all are flagged or masked)")
    valid = valid & np.isfinite(c.u) & np.isfinite(c.v)
    if not valid.any():
        raise InputError("correspondence: u or v is NaN in every valid pixel; both axes must be encoded")
    for name in ("sigma_u", "sigma_v"):
        sigma = getattr(c, name)
        wrong = valid & ~(np.isfinite(sigma) & (sigma >= 0))
        if wrong.any():
            row, col = np.argwhere(wrong)[0]
            raise InputError(
                f"correspondence: {name} = {sigma[row, col]} at pixel ({row}, {col}), which has no flag; "
                "must be finite and at least 0"
            )
    valid &= _on(c.u, c.sigma_u, pattern.cols) & _on(c.v, c.sigma_v, pattern.rows)
    if not valid.any():
        raise InputError(
            f"correspondence: no pixel lies on the scene's pattern of {pattern.rows} x {pattern.cols} cells"
        )
    return valid


def _on(at: NDArray[Any], sigma: NDArray[Any], extent: int) -> Mask:
    """Whether places lie on the pattern, but for noise and half a cell that the border's shadow moves."""
    with np.errstate(invalid="ignore"):
        beyond = np.maximum(-0.5 - at, at - (extent - 0.5))
        return np.asarray(beyond <= 0.5 + _NOISE * np.minimum(sigma, extent))


def _anchored_labels(data: Measured, samples: Samples) -> Labels:
    """The components of the grid that an anchor reaches, numbered from 1 on, 0 elsewhere."""
    if data.mask.all():
        labels = np.ones(data.mask.shape, np.int32)
    else:
        labels = scipy.ndimage.label(data.mask)[0].astype(np.int32)
    reached = np.unique(anchor_rows(samples, data, labels).component)
    reached = reached[np.bincount(labels.ravel())[reached] >= _FEWEST]
    if reached.size == labels.max():  # all of them
        return labels
    renumber = np.zeros(int(labels.max()) + 1, dtype=np.int32)
    renumber[reached] = np.arange(1, reached.size + 1)
    numbered: Labels = renumber[labels]
    return numbered
