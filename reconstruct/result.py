"""The solved grid as a HeightMap: points, sigma, flags, diagnostics."""

import hashlib
import math
from dataclasses import replace

import cv2
import numpy as np

from optolever.decode import Correspondence, Flag
from optolever.notices import Notice
from optolever.scene import Mirror, Scene, Surface, strided, trace

from .arrays import Floats, middle, some_rows
from .geometry import flat_mirror
from .heightmap import Diagnostics, HeightFlag, HeightMap
from .judgement.circulation import contradiction
from .judgement.discontinuities import surest
from .outputs.coarse_modes import coarse_step
from .problem import Problem
from .solver.anchors import Anchors
from .solver.newton import State
from .uncertainty.sources import ANCHORS

__all__ = [
    "against_rest", "anchors_apart", "anchors_near_wedge", "height_map", "off_mirror", "refused",
    "with_references", "without_unknown",
]  # fmt: skip

_MOSTLY = 0.5  # of the good pixels: lost, without a word
_LENGTH = "these pixels have no height; correct [mirror] size_mm, [accuracy] or the anchor"
_UNKNOWN = 0.25  # of the mirror's length: a height of such a sigma is none
_AROUND = np.ones((3, 3), np.uint8)
_LOST = 0.005  # of the pixels, that a rest capture does not know: above, they are named
_HOLLOW = 0.3  # of the depth: silicone rises less beside a contact
_DEEP = 5.0  # sigmas of a mean depth; how much deeper than high a map is that was exchanged
_APART = 5.0  # standard deviations, rms: rigs that are right stay below 1.2
_SURE = 3.0  # standard deviations
_WEDGE = 10.0  # times: of a prism within a tenth of its length
_MOVED, _UNIT = 0.02, 1e-3  # camera pixels: motion's own standard deviation; mm
_STEEP = 3.0  # standard deviations, of slopes or of the heights around: where doubts exceed them


def height_map(
    problem: Problem,
    state: State,
    correspondence: Correspondence,
    noise: dict[str, Floats],
    chi2: float | None,
    freedom: int,
    rig: bool = False,
    rest: bool = False,
) -> HeightMap:
    """noise: variance of the unknown by source; chi2, freedom: of the slopes' circulation, see `Diagnostics`;
    rig: after errors of the rig are taken off; rest: against a rest capture.
    """
    data, doubt, variance = problem.data, state.doubt, np.sum(list(noise.values()), axis=0)
    some = some_rows(variance)
    steep = np.zeros(data.mask.shape, dtype=np.bool_)
    if doubt is not None:
        # a doubt common to all of a pixel's edges is in the pixel's variance
        around = cv2.erode(np.where(data.mask, variance, np.inf), _AROUND, borderType=cv2.BORDER_REPLICATE)
        steep = surest(doubt, data.mask) > _STEEP * np.sqrt(around)
    distance = data.distance(state.w)
    solved = problem.to_image(data.mask, False) & problem.valid
    t = np.where(solved, problem.to_image(distance, np.nan), np.nan)
    o, d = problem.rays.inner_origins, problem.rays.inner_directions
    deviation = np.where(solved, _height_sigma(problem, state, variance), np.nan)
    flags = np.asarray(correspondence.flags, dtype=np.uint16).copy()
    flags[problem.suspects] |= np.uint16(HeightFlag.CURL)
    flags[~problem.valid & (flags == 0)] |= np.uint16(Flag.INVALID)
    singular = problem.singular
    flags[singular] |= np.uint16(HeightFlag.SINGULAR)
    flags[problem.valid & ~solved & ~singular] |= np.uint16(HeightFlag.NO_ANCHOR)
    flags[problem.to_image(steep, False) & solved] |= np.uint16(HeightFlag.STEEP)
    if not state.converged:
        # where noise moves single pixels, right before the pattern or at its edge, these alone
        moving = state.diverges | problem.to_image(np.asarray(state.unsettled), False)
        flags[solved & moving] |= np.uint16(HeightFlag.NOT_CONVERGED)
    diagnostics = Diagnostics(
        method="coupled",
        converged=state.converged,
        steps=state.steps,
        iterations=state.iterations,
        defect=float(np.sqrt(state.energy / (2 * np.count_nonzero(data.mask)))),
        components=int(problem.labels.max()),
        lost=problem.lost,
        chi2=chi2,
        freedom=freedom,
        noise={name: middle(each[some] / variance[some], data.mask[some]) for name, each in noise.items()},
    )
    points = t * d
    points += o
    x, y, z = points
    notices = correspondence.notices + _unconverged(state) + contradiction(chi2, freedom, rig, rest)
    return HeightMap(x, y, z, deviation, flags, diagnostics, problem.rays.lean, notices)


def _height_sigma(problem: Problem, state: State, variance: Floats) -> Floats:
    """Standard deviation of z, mm (H, W), by the unknown's variance (rows, cols); NaN off the grid."""
    sigma = np.sqrt(variance)
    if problem.data.rays.logarithmic:
        sigma = sigma * problem.data.distance(state.w)
    image: Floats = problem.to_image(sigma, np.nan) * np.abs(problem.rays.inner_directions[2])
    return image


def with_references(
    height: HeightMap,
    problem: Problem,
    state: State,
    noise: dict[str, Floats],
    corrected: Correspondence,
    anchor: Anchors,
    rest: Correspondence | None,
) -> HeightMap:
    """The height with its `references` and their part of sigma, `shared`, which a difference of two maps
    counts once; noise: see `sources`; corrected: the correspondence less the rest capture's deviation, the
    variances of both added."""
    known = noise.get(ANCHORS, np.zeros(state.w.shape))
    settled = _height_sigma(problem, state, known)
    parts: list[tuple[str, Floats]] = []
    if np.nanmax(settled, initial=0.0) > 0:
        parts.append((f"anchor {anchor!r}", np.fmin(settled, height.sigma)))
    if rest is not None:
        few = some_rows(rest.u)
        both = corrected.good[few] & rest.good[few]
        own, whole = (
            (
                sum(float(np.median(sigma[few][both])) ** 2 for sigma in (one.sigma_u, one.sigma_v))
                for one in (rest, corrected)
            )
            if both.any()
            else (0.0, 1.0)
        )
        others = np.sqrt(np.maximum(height.sigma**2 - np.nan_to_num(settled) ** 2, 0.0))
        digest = hashlib.blake2b(digest_size=8)
        for places in (rest.u, rest.v):
            digest.update(np.ascontiguousarray(places).data.cast("B"))
        parts.append((f"rest {digest.hexdigest()}", np.sqrt(own / whole) * others))
    if not parts:
        return height
    names, sigmas = tuple(name for name, _ in parts), np.stack([part for _, part in parts])
    return replace(height, references=names, shared=sigmas)


def refused(height: HeightMap, mistake: str | None) -> HeightMap:
    """The height with every pixel flagged, as no rig of the scene's accuracy can have taken the capture;
    mistake: in the scene, without which the capture fits, in words."""
    flags = height.flags | np.uint16(HeightFlag.IMPLAUSIBLE)
    cure = (
        f"with one change it fits: {mistake}; correct it"
        if mistake
        else "check pose, pitch and size of pattern and camera, and that the capture belongs to this scene"
    )
    name = "The capture contradicts its scene beyond the scene's accuracy; no height is trusted"
    return replace(height, flags=flags, notices=(*height.notices, Notice(name, math.nan, math.nan, cure)))


def without_unknown(height: HeightMap, mirror: Mirror) -> HeightMap:
    """The height with pixels flagged SINGULAR whose total sigma exceeds a quarter of the mirror's length."""
    unknown = height.good & (height.total_sigma > _UNKNOWN * mirror.length)
    if not unknown.any():
        return height
    share = np.count_nonzero(unknown) / np.count_nonzero(height.good)
    wide = Notice("total sigma exceeds a quarter of the mirror's length, share", share, _MOSTLY, _LENGTH)
    notices = (*height.notices, wide) if share > _MOSTLY else height.notices
    flags = height.flags | np.where(unknown, np.uint16(HeightFlag.SINGULAR), np.uint16(0))
    return replace(height, flags=flags, notices=notices)


def anchors_apart(problem: Problem, state: State, height: HeightMap) -> tuple[Notice, ...]:
    """The notice that the anchors (of the edge, its points) contradict each other, noise and rig considered:
    each against the height that they have in common."""
    data, rows, used = problem.data, state.rows, state.share > 0
    off = rows.predict(state.w, *state.slopes) - rows.known
    sigma = problem.to_grid(height.total_sigma / np.abs(problem.rays.inner_directions[2]))
    unit = data.distance(state.w) if data.rays.logarithmic else 1.0
    variance = np.square(sigma / unit).ravel()[rows.pixel]
    variance += rows.sigma**2 + rows.spread(*state.variances) + state.bend**2
    score = off[used] / np.sqrt(variance[used])
    apart = math.sqrt(np.nanmean(np.square(score))) if np.isfinite(score).any() else 0.0
    if not apart > _APART:
        return ()
    cure = (
        "heights err by more than sigma; a curved mirror's edge does not lie at z = 0 (reconstruct --anchor "
        "middle); on a flat one the scene is wrong: optolever calibrate, or reconstruct --rest"
    )
    return (Notice("The anchors contradict each other; rms in sigma", apart, _APART, cure),)


def anchors_near_wedge(state: State, height: HeightMap) -> tuple[Notice, ...]:
    """The notice that all anchors lie where the free mode is small, as where the mirror meets the pattern."""
    used = np.broadcast_to(state.root**2, state.w.shape).ravel()[state.rows.pixel[state.share > 0]]
    times = 1 / float(used.max(initial=0.0)) if used.any() else math.inf
    if not times > _WEDGE:
        return ()
    sigma = float(np.median(height.total_sigma[height.good])) if height.good.any() else math.nan
    cure = (
        f"total_sigma is {sigma:.2g} mm (median) by that; anchor the mirror farther from where it meets the "
        "pattern, or capture it at rest (reconstruct --rest)"
    )
    return (
        Notice("The error of the anchors grows towards the mirror's other end, times", times, _WEDGE, cure),
    )


def against_rest(
    height: HeightMap, press: Correspondence, corrected: Correspondence, scene: Scene
) -> tuple[Notice, ...]:
    """Notices of a map against a rest capture: pixels that this capture does not know; a press that lifts the
    mirror of a sensor, as if both captures were exchanged or one had a contact at rest."""
    found, z = [], height.z[height.good]
    lost = int(np.count_nonzero(press.good & ~corrected.good))
    if lost > _LOST * press.u.size:
        rows, cols = (np.flatnonzero((press.good & ~corrected.good).any(axis=axis)) for axis in (1, 0))
        where = f"rows {rows[0]} to {rows[-1]}, columns {cols[0]} to {cols[-1]}"
        name = (
            f"The rest capture has no coordinates for {lost} pixels of the press ({where}): no height there"
        )
        found.append(
            Notice(name, lost / press.u.size, _LOST, "capture the mirror at rest with the same exposure")
        )
    if z.size:
        found += _moved(height, corrected, scene)
    if scene.medium is None or not z.size:
        return tuple(found)
    sigma = float(np.median(height.sigma[height.good]))
    lowest, highest, low = float(-z.min()), max(float(z.max()), 0.0), "Heights lie below those at rest, mm:"
    if lowest > _DEEP * max(sigma, highest):
        name = f"{low} press and rest are probably exchanged"
        found.append(Notice(name, lowest, _DEEP * sigma, "exchange C.npz and reconstruct --rest"))
    elif lowest > _HOLLOW * highest and lowest > _DEEP * height.total_sigma[height.good][z.argmin()]:
        name = f"{low} the rest capture probably shows a contact"
        cure = "take everything off the mirror and capture it at rest again"
        found.append(Notice(name, lowest, _HOLLOW * highest, cure))
    return tuple(found)


def _moved(height: HeightMap, corrected: Correspondence, scene: Scene) -> list[Notice]:
    """The notice that the picture has moved since rest as if the mirror had sunk evenly, which is taken for
    motion of the rig: median over the map."""
    step = coarse_step(height.z.shape)
    few, scene = np.s_[::step, ::step], strided(scene, step)
    flat = flat_mirror(scene)
    lower = trace(scene, Surface(lambda x, y: 0 * x * y + _UNIT, lambda x, y: (0 * x, 0 * y)))
    field = (np.stack([lower.u, lower.v]) - flat) / _UNIT
    moved, size = np.stack([corrected.u[few], corrected.v[few]]) - flat, np.square(field).sum(axis=0)
    pixel = np.hypot(*np.gradient(flat, axis=2)) / step
    known = height.good[few] & np.isfinite(moved).all(axis=0) & (size > 0) & (pixel > 0)  # not NaN
    if not known.any():
        return []
    sunk = abs(float(np.median(((moved * field).sum(axis=0) / size)[known])))
    shift = sunk * float(np.median((np.sqrt(size) / pixel)[known]))
    cure = (
        f"as of a mirror that sank by {1e3 * sunk:.2g} µm; heights count it as the rig's motion, total_sigma "
    )
    cure += "lacks it: clamp the rig, let it warm up, and capture the mirror at rest again"
    name = "The picture has moved as a whole since rest, pixels"
    return [Notice(name, shift, _MOVED, cure)] if shift > _MOVED else []


def off_mirror(height: HeightMap, mirror: Mirror, at_rest: bool) -> tuple[Notice, ...]:
    """The notice that good pixels lie off the mirror by more than one pixel, which may see it in part, and
    the uncertainty of their positions."""
    x, y = height.x[height.good], height.y[height.good]
    if x.size == 0:
        return ()
    farthest = float(max(-x.min(), x.max() - mirror.length, -y.min(), y.max() - mirror.width))
    if farthest <= 0:
        return ()
    step = float(np.nanmax(np.hypot(np.diff(height.x, axis=1), np.diff(height.y, axis=1)), initial=0))
    moves = np.zeros((1, 2, 3)) if height.displacement is None else height.displacement
    corners = [[1.0, x, y] for x in (0.0, mirror.length) for y in (0.0, mirror.width)]
    limit = step + _SURE * max(float(np.linalg.norm(moves @ corner)) for corner in corners)
    if farthest <= limit:
        return ()
    cure = (
        "x and y are shifted by as much; most likely the mirror's size or the camera's place is wrong in the "
        "scene: correct it, or calibrate with a ball"
    ) + ("" if at_rest else "; or the anchor is no point of the mirror")
    return (Notice("Points lie beyond the mirror's edge, mm", farthest, limit, cure),)


def _unconverged(state: State) -> tuple[Notice, ...]:
    """The notice that no height is known since the solve failed."""
    if not state.diverges:
        return ()
    name = "The solve did not converge, so no height is known; last step over the first"
    cure = (
        "most likely the scene is wrong: optolever calibrate, or reconstruct --rest with a capture of the "
        "mirror at rest"
    )
    return (Notice(name, state.steps[-1] / state.steps[0], 0.0, cure),)
