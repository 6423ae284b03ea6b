"""Crossings of the paper's lattice: sub-pixel in the rest frame, tracked into a deformed one."""

from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import cKDTree

from optolever.errors import InputError
from optolever.files import load_arrays, save_arrays
from optolever.patterns import Frame, Sequence, lattice_lines

from .prior import PatternMap, prior_map
from .corners import Found, locate

__all__ = ["Crossings", "lattice"]

F64 = NDArray[np.float64]
_SIDES = ((1, 0), (-1, 0), (0, 1), (0, -1))
_TRIES = 4
#: Of the local period: how far from its expected place a crossing may lie, in rounds.
_LIMITS = (0.12, 0.25, 0.5)


@dataclass(frozen=True, slots=True)
class Crossings:
    """K crossings found at rest; `now` is NaN and `sigma` inf where one was not found again.

    index  (K, 2) numbers of the lines along u and v      pattern  (K, 2) their u, v, pattern pixels
    rest   (K, 2) row, col at rest, camera pixels          now      (K, 2) row, col in the deformed frame
    sigma, sigma_rest  (K, 2) standard deviations of row, col, camera pixels
    """

    index: NDArray[np.int64]
    pattern: F64
    rest: F64
    now: F64
    sigma: F64
    sigma_rest: F64

    @property
    def found(self) -> NDArray[np.bool_]:
        """True where the crossing was found in both frames, (K,)."""
        return np.asarray(np.isfinite(self.now).all(axis=1))

    def save(self, path: str | Path) -> None:
        """Write an .npz with the fields' names."""
        save_arrays(path, {field.name: getattr(self, field.name) for field in fields(self)})

    @classmethod
    def load(cls, path: str | Path) -> "Crossings":
        """Read what save() wrote."""
        names = [field.name for field in fields(cls)]
        arrays = load_arrays(path, names)
        return cls(**{name: arrays[name] for name in names})


def lattice(
    frames: ArrayLike, rest: ArrayLike, sequence: Sequence, *, prior: PatternMap | None = None
) -> Crossings:
    """Crossings of the lattice in `frames`, each matched to the same one in `rest`.

    frames, rest  (N, H, W) as the sequence describes them, or the lattice frame alone, (H, W)
    prior         where the camera looked at rest, to a quarter of the lattice's period (a trace, a decoded
                  capture); default: the surface fills the frame, u along columns, v along rows

    A crossing is matched by walking from crossings that have not moved to their neighbours, so the
    displacement may be many periods as long as it changes by less than half a period from one to the next.
    """
    frame = _lattice_frame(sequence)
    image, still = (_image(stack, sequence, name) for stack, name in ((frames, "frames"), (rest, "rest")))
    if image.shape != still.shape:
        raise InputError(f"lattice: frames are {image.shape}, rest is {still.shape}, must be equal")
    index, pattern = _grid(frame, sequence)
    start, steps = _expected(pattern, sequence, prior, still.shape)
    inside = np.isfinite(start).all(axis=1) & np.isfinite(steps).all(axis=(1, 2))
    found = locate(still, start[inside], steps[inside], frame.period_px or 1.0, frame.width_px or 1.0)
    keep = found.ok
    index, pattern = index[inside][keep], pattern[inside][keep]
    at_rest = Found(found.point[keep], found.sigma[keep], found.ok[keep])
    if len(index) == 0:
        raise InputError("lattice: no crossing was found in the rest frame; is the prior that frame's?")
    now = _track(image, still, index, at_rest, steps[inside][keep], frame)
    at_rest, now = (_straightened(found, index, frame) for found in (at_rest, now))
    return Crossings(index, pattern, at_rest.point, now.point, now.sigma, at_rest.sigma)


def _lattice_frame(sequence: Sequence) -> Frame:
    for frame in sequence.frames:
        if frame.kind == "lattice":
            return frame
    raise InputError(f"lattice: sequence {sequence.name} has no frame of kind 'lattice'")


def _image(stack: ArrayLike, sequence: Sequence, name: str) -> NDArray[np.float32]:
    """The lattice frame, float32."""
    array = np.asarray(stack)
    if array.ndim == 3:
        if len(array) != len(sequence):
            raise InputError(f"lattice: {name} has {len(array)} images, sequence describes {len(sequence)}")
        array = array[[frame.kind for frame in sequence.frames].index("lattice")]
    if array.ndim != 2 or min(array.shape) < 8:
        raise InputError(f"lattice: {name} has shape {array.shape}, must be (H, W), at least 8 x 8")
    if not np.isfinite(array).all():
        raise InputError(f"lattice: {name} holds values that are not finite")
    return array.astype(np.float32)


def _grid(frame: Frame, sequence: Sequence) -> tuple[NDArray[np.int64], F64]:
    """Index and pattern coordinates of all crossings, (K, 2)."""
    along_u, along_v = lattice_lines(frame, sequence.cols), lattice_lines(frame, sequence.rows)
    i, j = (axis.ravel() for axis in np.meshgrid(np.arange(len(along_u)), np.arange(len(along_v))))
    return np.stack([i, j], axis=1), np.stack([along_u[i], along_v[j]], axis=1)


def _expected(
    pattern: F64,
    sequence: Sequence,
    prior: PatternMap | None,
    shape: tuple[int, ...],
) -> tuple[F64, F64]:
    """Expected places at rest (K, 2), and camera steps (row, col) per pattern pixel of u, v (K, 2, 2)."""
    if prior is None:
        scale = np.array([shape[0] / sequence.rows, shape[1] / sequence.cols])
        point = (pattern[:, ::-1] + 0.5) * scale - 0.5
        steps = np.array([[0.0, scale[1]], [scale[0], 0.0]])
        return point, np.broadcast_to(steps, (len(point), 2, 2)).copy()
    u, v = prior_map(prior, sequence, shape)
    return _inverse(u, v, pattern)


def _inverse(u: F64, v: F64, pattern: F64) -> tuple[F64, F64]:
    """Camera places (K, 2) of pattern coordinates and camera steps (K, 2, 2) there; NaN outside the map.

    From the nearest of a grid of pixels two Newton steps lead there: a map at rest is smooth.
    """
    thin = max(2, int(np.sqrt(u.size / 40000)))
    gradient = np.stack([np.stack([*np.gradient(part)], axis=-1) for part in (u, v)], axis=-2)
    row, col = (axis.ravel() for axis in np.mgrid[1 : u.shape[0] - 1 : thin, 1 : u.shape[1] - 1 : thin])
    determinant = np.linalg.det(gradient[row, col])
    good = np.isfinite(u[row, col]) & np.isfinite(v[row, col]) & (np.abs(determinant) > 1e-6)
    if np.count_nonzero(good) < 4:
        raise InputError("lattice: prior holds fewer than 4 finite pixels")
    row, col = row[good], col[good]
    nearest = cKDTree(np.stack([u[row, col], v[row, col]], axis=1)).query(pattern)[1]
    place = np.stack([row[nearest], col[nearest]], axis=1).astype(np.float64)
    for _ in range(3):
        at = tuple(np.clip(np.rint(place[:, k]), 0, u.shape[k] - 1).astype(int) for k in (0, 1))
        jacobian = gradient[at]
        usable = np.abs(np.linalg.det(np.nan_to_num(jacobian))) > 1e-6
        inverse = np.full(jacobian.shape, np.nan)
        inverse[usable] = np.linalg.inv(jacobian[usable])
        missing = pattern - np.stack([u[at], v[at]], axis=1)
        place = np.stack(at, axis=1) + np.einsum("kij,kj->ki", inverse, missing)
        place[~np.isfinite(place)] = -1.0
    outside = ((place < 0) | (place > np.array(u.shape) - 1)).any(axis=1)
    place[outside] = np.nan
    return place, inverse.transpose(0, 2, 1)


def _track(
    image: NDArray[np.float32],
    still: NDArray[np.float32],
    index: NDArray[np.int64],
    rest: Found,
    steps: F64,
    frame: Frame,
) -> Found:
    """Waves of neighbours, from the crossings that did not move."""
    count = len(index)
    number = {(int(i), int(j)): k for k, (i, j) in enumerate(index)}
    point, sigma = np.full((count, 2), np.nan), np.full((count, 2), np.inf)
    period, width = frame.period_px or 1.0, frame.width_px or 1.0
    front = {k: (rest.point[k], steps[k]) for k in _unmoved(image, still, rest.point)}
    local = steps.copy()
    # what lies far from where it is expected waits until more of its neighbours are known
    for limit in _LIMITS:
        tried: dict[int, int] = {}
        while front:
            chosen = np.fromiter(front, np.int64)
            start, step = (np.array([front[k][part] for k in chosen]) for part in (0, 1))
            found = locate(image, start, step, period, width)
            reach = limit * period * np.sqrt(np.abs(np.linalg.det(step)))
            off = np.hypot(*np.nan_to_num(found.point - start, nan=np.inf).T)
            accepted = chosen[found.ok & (off < reach)]
            for k in chosen:
                tried[k] = tried.get(k, 0) + 1
            point[accepted], sigma[accepted] = (
                part[found.ok & (off < reach)] for part in (found.point, found.sigma)
            )
            front = _neighbours(accepted, index, number, point, rest.point, local, tried, period)
        known = np.flatnonzero(np.isfinite(point[:, 0]))
        front = _neighbours(known, index, number, point, rest.point, local, {}, period)
    _drop_doubtful(point, sigma, index, number, rest.point, local, period)
    return Found(point, sigma, np.isfinite(point).all(axis=1))


def _drop_doubtful(
    point: F64,
    sigma: F64,
    index: NDArray[np.int64],
    number: dict[tuple[int, int], int],
    rest: F64,
    local: F64,
    period: float,
) -> None:
    """Forget crossings that two lines claim, and those that break out of the line of their neighbours."""
    size = period * np.sqrt(np.abs(np.linalg.det(local)))
    drop = np.zeros(len(point), bool)
    found = np.flatnonzero(np.isfinite(point[:, 0]))
    for k, other in cKDTree(point[found]).query_pairs(0.3 * float(np.median(size[found]))):
        drop[found[k]] = drop[found[other]] = True
    shift = point - rest
    for k in found:
        i, j = int(index[k][0]), int(index[k][1])
        for di, dj in ((1, 0), (0, 1)):
            ahead, behind = number.get((i + di, j + dj), -1), number.get((i - di, j - dj), -1)
            bend = shift[ahead] - 2 * shift[k] + shift[behind]
            if ahead >= 0 and behind >= 0 and np.isfinite(bend).all() and np.hypot(*bend) > size[k]:
                drop[ahead] = drop[k] = drop[behind] = True
    point[drop], sigma[drop] = np.nan, np.inf


def _straightened(found: Found, index: NDArray[np.int64], frame: Frame) -> Found:
    """Take off what the map's curvature does to the centroid of a line of finite width.

    Where the place x of pattern coordinate q curves, a line's darkness spreads as x'(q) dq, and its centroid
    lies at x + 3/2 x'' m2, m2 = width^2 / 12. x'' from the neighbours; a third of the shift goes into sigma.
    """
    period, second_moment = frame.period_px or 1.0, (frame.width_px or 0.0) ** 2 / 12
    number = {(int(i), int(j)): k for k, (i, j) in enumerate(index)}
    point, sigma = found.point.copy(), found.sigma.copy()
    for k, (i, j) in enumerate(index.tolist()):
        for di, dj in ((1, 0), (0, 1)):
            ahead, behind = number.get((i + di, j + dj), -1), number.get((i - di, j - dj), -1)
            if ahead < 0 or behind < 0:
                continue
            along = found.point[ahead] - found.point[behind]
            bend = found.point[ahead] - 2 * found.point[k] + found.point[behind]
            if not np.isfinite(bend).all():
                continue
            along /= np.hypot(*along)
            shift = 1.5 * second_moment / period**2 * float(bend @ along) * along
            point[k] -= shift
            sigma[k] = np.hypot(sigma[k], shift / 3)
    return Found(point, sigma, found.ok)


def _unmoved(image: NDArray[np.float32], still: NDArray[np.float32], points: F64) -> list[int]:
    """Crossings around which the two frames differ least: the seeds (at least one, at most all)."""
    rows, cols = still.shape
    change = np.empty(len(points))
    for k, (row, col) in enumerate(np.rint(points).astype(int)):
        cut = (slice(max(row - 4, 0), min(row + 5, rows)), slice(max(col - 4, 0), min(col + 5, cols)))
        change[k] = float(np.sqrt(np.mean((image[cut] - still[cut]) ** 2)))
    return [int(k) for k in np.flatnonzero(change <= 1.5 * change.min() + 1e-6)]


def _neighbours(
    fresh: NDArray[np.int64],
    index: NDArray[np.int64],
    number: dict[tuple[int, int], int],
    point: F64,
    rest: F64,
    local: F64,
    tried: dict[int, int],
    period: float,
) -> dict[int, tuple[F64, F64]]:
    """Next wave: places expected from a found crossing, its own neighbour's displacement carried on."""
    front: dict[int, tuple[F64, F64]] = {}
    for k in fresh:
        i, j = int(index[k][0]), int(index[k][1])
        _update_steps(k, i, j, number, point, local, period)
        for di, dj in _SIDES:
            n = number.get((i + di, j + dj), -1)
            if n < 0 or np.isfinite(point[n, 0]) or tried.get(n, 0) >= _TRIES or n in front:
                continue
            shift = _predicted_shift(i + di, j + dj, number, point, rest)
            front[n] = (rest[n] + shift, local[k])
    return front


def _predicted_shift(i: int, j: int, number: dict[tuple[int, int], int], point: F64, rest: F64) -> F64:
    """Displacement (2,) expected of crossing i, j: the plane through those found around it, by distance."""
    around = [(di, dj) for di in range(-2, 3) for dj in range(-2, 3)]
    known = [
        (n, di, dj)
        for di, dj in around
        if (n := number.get((i + di, j + dj), -1)) >= 0 and np.isfinite(point[n, 0])
    ]
    places = np.array([n for n, _, _ in known])
    steps = np.array([(di, dj) for _, di, dj in known], np.float64)
    weight = 1 / (steps**2).sum(axis=1)
    design = np.column_stack([np.ones(len(steps)), steps]) * weight[:, None]
    # slopes are held near zero until neighbours on several sides speak for them
    held = np.vstack([design, np.diag([0.0, 0.3, 0.3])])
    values = np.vstack([(point[places] - rest[places]) * weight[:, None], np.zeros((3, 2))])
    return np.asarray(np.linalg.lstsq(held, values, rcond=None)[0][0])


def _update_steps(
    k: int, i: int, j: int, number: dict[tuple[int, int], int], point: F64, local: F64, period: float
) -> None:
    """Local camera steps per pattern pixel from neighbours that are found."""
    for axis, (di, dj) in enumerate(((1, 0), (0, 1))):
        ahead, behind = number.get((i + di, j + dj), -1), number.get((i - di, j - dj), -1)
        places = [point[n] if n >= 0 and np.isfinite(point[n, 0]) else None for n in (ahead, behind)]
        if places[0] is not None and places[1] is not None:
            local[k, axis] = (places[0] - places[1]) / (2 * period)
        elif places[0] is not None:
            local[k, axis] = (places[0] - point[k]) / period
        elif places[1] is not None:
            local[k, axis] = (point[k] - places[1]) / period
