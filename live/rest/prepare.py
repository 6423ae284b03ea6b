"""Precomputation for the live chain: from a scene, its rest map and frames at rest."""

from __future__ import annotations

import math
from dataclasses import replace

import cv2
import numpy as np
import scipy.ndimage
from numpy.typing import ArrayLike

from optolever.arrays import Cells, Floats, Frame, Mask
from optolever.decode import Correspondence
from optolever.errors import InputError
from optolever.notices import Notice
from optolever.patterns import Sequence
from optolever.records import logged
from optolever.scene import Scene

from ..fringe.chain import LEAST_SHARE, Rig, rest_state, settle
from ..fringe.chord import linearised
from ..fringe.circulation import BLOCKS, circulations
from ..fringe.picture import CELLS, Carriers, State, model, to_cells, window_mean
from ..fringe.rays_at_rest import anchor_line, rest_rays, rim
from .prepared import Noise, Prepared
from .rig_errors import relative_error
from .rig_motion import fitted, rig_motion

__all__ = ["prepare", "stated"]

_WINDOW = 0.5  # periods, rms: less leaks between level and fringes, more smooths kinks
_LEAST_WINDOW = 0.5  # cells, rms
_BESIDE = 1.0  # pattern pixels: margin at the border, where a footprint may exceed the pattern
_DRAWS = 48
_QUANTISED = 1 / 12  # levels^2: variance by the rounding of a simulated frame
_SMOOTH = 6.0  # cells: of the map of variances
_FIRST_SIGMA = 1e-5  # mm: before it is measured
_WHOLE = 0.999  # share of a cell's window that is lit
_ELSEWHERE, _FEW = 0.05, 0.03  # periods: ten times what a fringe at rest shows; share of the cells
_PLACED = 0.25  # periods: sigma of the rest map, at most
_APART = 2.0  # times the median of the frames' mean square differences from their median


def prepare(
    scene: Scene,
    rest_frames: ArrayLike,
    rest_map: Correspondence,
    sequence: Sequence,
    *,
    cell: int = 2,
    bits: int | None = None,
    seed: int = 0,
) -> Prepared:
    """The precomputed record of a rig at rest for `Live`.

    rest_frames: (N, H, W) of the crossed fringe `sequence`, two or more, to measure the noise; rest_map:
    decoded from a dense capture of the same rest; cell: pixels along the side of a cell; bits: of the camera
    (default: those of the frames' type); seed: of the simulated noise that is propagated through the chain.
    InputError where the arguments do not match."""
    period = _period(scene, sequence)
    frames, others = _agreeing(_frames(scene, rest_frames, rest_map))
    if cell not in CELLS:
        raise InputError(f"cell = {cell}: must be one of {CELLS}")
    side = (max(BLOCKS) + 1) * cell
    if min(frames.shape[1:]) < side:
        size, least = "{} x {}".format(*frames.shape[1:]), f"{side} x {side}"
        raise InputError(f"frames: {size} pixels, must be at least {least} in cells of {cell}")
    with logged(f"prepare {frames.shape[1]} x {frames.shape[2]} pixels in cells of {cell}"):
        full = 2 ** (bits or 8 * frames.dtype.itemsize) - 1
        carriers = _carriers(scene, rest_map, period, cell, full)
        rows, cols = (cell * count for count in carriers.shape)
        frames = frames[:, :rows, :cols]
        lit = np.asarray(carriers.share > LEAST_SHARE)
        rays = rest_rays(scene, *carriers.shape, cell, period).regular(lit)
        line = anchor_line(scene, rays, lit)
        mirror = linearised(rays, line, lit)
        mean = frames.mean(axis=0, dtype=np.float64).astype(np.float32)
        noise = float(np.var(frames, axis=0, ddof=1, dtype=np.float64)[carriers.lit > 0].mean())
        normal = rays.directions[2].astype(np.float32)
        rest = _rest_state(carriers, mean)
        others += _elsewhere(carriers, rest)
        if noise == 0:  # one image several times, as of a simulated camera: then what the model leaves of it
            left = (mean - model(carriers, rest))[carriers.lit > 0]
            noise = (1.4826 * float(np.median(np.abs(left)))) ** 2
        rig = Rig(carriers, mirror, rest, max(noise, _QUANTISED), _gradient(carriers), normal, rim(lit))
        x, y = rays.points[:2]
        (x_row, x_col), (y_row, y_col) = np.gradient(x), np.gradient(y)
        area = float(np.median(np.abs(x_col * y_row - x_row * y_col)[lit]))
        points = rays.points.astype(np.float32)
        with np.errstate(over="ignore", invalid="ignore"):
            measured = _measured_noise(rig, points, seed, frames.dtype)
    if not np.isfinite(measured.displacement).all():
        fine = f"a period of {period:g} pattern pixels is too fine for the camera: take a longer one"
        other = "or the frames show another pattern than rest_map's mirror: capture both anew"
        raise InputError(f"rest_frames: the fit of the fringe at rest does not converge; {fine}, {other}")
    shape = scene.camera.rows, scene.camera.cols
    notices = (*others, *_notices(scene, line.edge))
    return stated(Prepared(rig, measured, *shape, points, area, 0.0, notices=notices), scene)


def stated(known: Prepared, scene: Scene) -> Prepared:
    """A rig at rest with the layer and the errors that its scene states now."""
    carriers, edge = known.rig.carriers, 0.0 if scene.accuracy is None else scene.accuracy.edge
    error = relative_error(scene, known.rig.lit, carriers.cell, carriers.period)
    return replace(known, edge=edge, error=error, layer=scene.layer)


def _agreeing(frames: Frame) -> tuple[Frame, tuple[Notice, ...]]:
    """The frames that agree with their median, two at least; a notice of the others."""
    median = np.median(frames, axis=0).astype(np.float32)
    apart = np.array([np.square(frame - median).mean() for frame in frames])
    same = apart <= max(_APART * np.median(apart), np.sort(apart)[1])
    count, name = int(np.count_nonzero(~same)), f"Frames at rest unlike the others, of {len(same)}"
    cure = "they are left out; keep display and mirror still while it is measured"
    return frames[same], (Notice(name, count, 0, cure),) if count else ()


def _elsewhere(carriers: Carriers, rest: State) -> tuple[Notice, ...]:
    """The notice of cells whose fringe is not where the rest map puts it; InputError where most are not."""
    turns = np.hypot(*rest.displacement)[carriers.share > _WHOLE]
    if not turns.size:
        return ()
    most, share = float(np.median(turns)), float((turns > 2 * _ELSEWHERE).mean())
    if most > _ELSEWHERE:
        cure = "give the period shown, and frames and map of the same mirror, neither mirrored nor turned"
        raise InputError(
            f"rest_frames: the fringe lies {most:.2g} periods from where rest_map puts it (median, at most "
            f"{_ELSEWHERE:g}): {cure}"
        )
    name, cure = "Cells at rest whose fringe is elsewhere than by rest_map, share", "measure it at rest anew"
    return (Notice(name, share, _FEW, cure),) if share > _FEW else ()


def _notices(scene: Scene, edge: bool) -> tuple[Notice, ...]:
    border = "The camera does not see the edge x = L0: the border of the visible part counts as at rest"
    bent = "The pattern is not flat: displacements of the image are taken along its plane"
    deep = "The [layer] has no thickness_mm: forces are of a half-space"
    half_space = scene.layer is not None and scene.layer.thickness_mm is None
    possible = (
        (not edge, border, "heights are relative to that border; keep contacts away from it"),
        (half_space, deep, "give thickness_mm: of a layer on a base they are up to four times as large"),
        (scene.pattern.shape is not None, bent, "measure heights of large slopes with a dense sequence"),
    )
    return tuple(Notice(name, math.nan, math.nan, cure) for holds, name, cure in possible if holds)


def _period(scene: Scene, sequence: Sequence) -> float:
    pattern = scene.pattern
    if (sequence.rows, sequence.cols) != (pattern.rows, pattern.cols):
        raise InputError(
            f"sequence: made for {sequence.rows} x {sequence.cols} pixels, the scene's pattern has "
            f"{pattern.rows} x {pattern.cols}"
        )
    if len(sequence) != 1 or sequence.frames[0].kind != "crossed":
        raise InputError(
            f"sequence: {len(sequence)} frames of {sequence.frames[0].kind!r}, must be one crossed fringe: "
            "patterns.sequence('crossed', rows, cols)"
        )
    return float(sequence.frames[0].period_px or 0.0)


def _frames(scene: Scene, rest_frames: ArrayLike, rest_map: Correspondence) -> Frame:
    shape = scene.camera.rows, scene.camera.cols
    frames: Frame = np.asarray(rest_frames)
    if frames.ndim != 3 or frames.shape[0] < 2 or frames.dtype not in (np.uint8, np.uint16):
        raise InputError(
            f"rest_frames: {frames.dtype} of shape {frames.shape}, "
            "must be two or more frames (N, H, W) of uint8 or uint16: their differences tell the noise"
        )
    for name, found in (("rest_frames", frames.shape[1:]), ("rest_map", rest_map.u.shape)):
        if found != shape:
            raise InputError(f"{name}: {found} pixels, the scene's camera has {shape}")
    return frames


def _carriers(scene: Scene, rest_map: Correspondence, period: float, cell: int, full: float) -> Carriers:
    rows, cols = (count // cell * cell for count in rest_map.u.shape)
    inside = slice(rows), slice(cols)
    u, v = (np.asarray(part[inside], np.float64) for part in (rest_map.u, rest_map.v))
    sigma = np.maximum(rest_map.sigma_u, rest_map.sigma_v)[inside]
    lit = rest_map.good[inside] & np.isfinite(u) & np.isfinite(v) & (sigma < _PLACED * period)
    lit = scipy.ndimage.binary_erosion(lit)  # a pixel at the end sees beyond once the picture moves
    if np.count_nonzero(lit) < 0.1 * lit.size:
        known = f"good, and known to {_PLACED:g} of the fringe's period"
        raise InputError(
            f"rest_map: {100 * lit.mean():.2g} % of the pixels are {known}, must be 10 % at least"
        )
    u, v = (np.where(lit, part, 0.0) for part in (u, v))
    slopes = [float(np.median(np.hypot(*np.gradient(part))[lit])) for part in (u, v)]
    rms = _WINDOW * period / max(min(slopes), 1e-3)
    blur = math.sqrt(max(rms**2 - (cell**2 - 1) / 12, 0.0)) / cell
    if blur < _LEAST_WINDOW:
        raise InputError(
            f"cell = {cell}: a period of {period:g} pattern pixels spans "
            f"{period / min(slopes):.3g} camera pixels, too few for it; take smaller cells or a longer period"
        )
    window = cv2.getGaussianKernel(2 * math.ceil(3.5 * blur) + 1, blur).astype(np.float32).ravel()
    pattern, near = scene.pattern, _BESIDE - 0.5
    ends = np.array([near, pattern.cols - 1 - near, near, pattern.rows - 1 - near]) / period
    known = lit.astype(np.float32)
    share = window_mean(to_cells(known, cell), window)
    turn_u, turn_v = ((part / period).astype(np.float32) for part in (u, v))
    return Carriers(period, cell, window, turn_u, turn_v, known, ends.astype(np.float32), full, share)


def _gradient(carriers: Carriers) -> Cells:
    """Changes of the rest map's turns a cell (4, R, C); those of cells that are not lit are medians."""
    seen = to_cells(carriers.lit, carriers.cell) > 0.999
    lit: Mask = scipy.ndimage.binary_erosion(seen, border_value=1)
    planes: list[Floats] = []
    for axis in (1, 0):
        for turns in (carriers.turn_u, carriers.turn_v):
            change = np.gradient(to_cells(turns, carriers.cell), axis=axis)
            planes.append(np.where(lit, change, np.median(change[lit])))
    return np.asarray(planes, np.float32)


def _rest_state(carriers: Carriers, mean: Frame) -> State:
    planes = np.zeros((5, *carriers.shape), np.float32)
    planes[2] = mean[carriers.lit > 0].mean()
    planes[3:] = 1.0
    return rest_state(carriers, mean, State(planes))


def _measured_noise(
    rig: Rig, points: Cells, seed: int, kind: np.dtype[np.uint8] | np.dtype[np.uint16]
) -> Noise:
    """Noise of the chain by simulation: frames at rest with the measured noise."""
    rng = np.random.default_rng(seed)
    clean = model(rig.carriers, rig.rest)
    spread = np.float32(math.sqrt(max(rig.noise - _QUANTISED, 0.0)))
    sigma = np.full(rig.carriers.shape, _FIRST_SIGMA, np.float32)
    squares, curls, scatter = np.zeros(rig.carriers.shape), [], []
    creep = rig_motion(rig, points)
    for _ in range(_DRAWS):
        noisy = clean + spread * rng.standard_normal(clean.shape, dtype=np.float32)
        frame = np.clip(np.rint(noisy), 0, rig.carriers.full - 1).astype(kind)
        settled = settle(rig, frame, sigma)
        offset = settled.state.displacement - rig.rest.displacement
        found = fitted(creep, offset, settled.good, (), None, (1.0, 1.0))
        scatter.append((found.misfit**2, float(np.mean(np.square(found.motion / found.sigmas[:3])))))
        z = settled.tau * rig.normal + found.heights(creep)
        squares += np.square(z, dtype=np.float64)
        curls.append(circulations(settled.slopes, settled.good & rig.whole))
    sigma = np.sqrt(scipy.ndimage.gaussian_filter(squares / _DRAWS, _SMOOTH, mode="nearest"))
    curl = np.mean(curls, axis=0)
    curl[curl == 0] = 1.0  # no complete block: no verdict by it
    displacement = np.mean(scatter, axis=0).astype(np.float32)
    return Noise(sigma.astype(np.float32), curl, displacement)
