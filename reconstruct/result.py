"""The solved grid as a HeightMap: points, sigma, flags, diagnostics."""

import hashlib
from dataclasses import replace

import cv2
import numpy as np

from optolever.arrays import Floats, Mask, middle, some_rows
from optolever.decode import Correspondence, Flag
from optolever.notices import Judged
from optolever.scene import Mirror

from .heightmap import Diagnostics, HeightFlag, HeightMap
from .judgement.discontinuities import surest
from .problem import Problem
from .solver.anchors import Anchors
from .solver.newton import State
from .uncertainty.sources import ANCHORS

__all__ = ["UNKNOWN", "height_map", "refused", "with_references", "without_unknown"]

UNKNOWN = 0.25  # of the mirror's length: a height of such a sigma is none
_AROUND = np.ones((3, 3), np.uint8)
_STEEP = 3.0  # standard deviations, of slopes or of the heights around: where doubts exceed them


def height_map(
    problem: Problem,
    state: State,
    correspondence: Correspondence,
    noise: dict[str, Floats],
    chi2: float | None,
    freedom: int,
) -> HeightMap:
    """noise: variance of the unknown by source; chi2, freedom: of the slopes' circulation, see
    `Diagnostics`."""
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
    moving, settled = _moving(problem, state, deviation)
    flags[solved & moving] |= np.uint16(HeightFlag.NOT_CONVERGED)
    diagnostics = Diagnostics(
        method="coupled",
        converged=not settled.fails,
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
    return HeightMap(
        x, y, z, deviation, flags, diagnostics, problem.rays.lean, correspondence.notices, (settled,)
    )


def _moving(problem: Problem, state: State, sigma: Floats) -> tuple[Mask, Judged]:
    """Pixels (H, W) that the last step still moved by more than their sigma, all where the solve diverges;
    and whether there are none."""
    if state.diverges:
        words = "The solve did not converge, so no height is known; last step over the first"
        cure = (
            "most likely the scene is wrong: optolever calibrate, or reconstruct --rest with a capture of "
            "the mirror at rest"
        )
        ratio = state.steps[-1] / state.steps[0]
        return np.ones(sigma.shape, np.bool_), Judged("converged", ratio, 0.0, words, cure)
    last = _height_sigma(problem, state, np.square(state.w - state.before)) / sigma
    unsettled = np.zeros(sigma.shape, np.bool_)
    if state.unsettled is not None:
        unsettled = problem.to_image(state.unsettled, False)
    # where noise moves single pixels, right before the pattern or at its edge, these alone
    moving = unsettled & (last > 1.0)
    words = "The solve did not converge in all pixels; last step over sigma, at most"
    most = float(np.max(last, initial=0.0, where=unsettled & np.isfinite(last)))
    return moving, Judged("converged", most, 1.0, words, "the others are not affected; these are flagged")


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


def refused(height: HeightMap) -> HeightMap:
    """The height with every pixel flagged, as no rig of the scene's accuracy can have taken the capture."""
    return replace(height, flags=height.flags | np.uint16(HeightFlag.IMPLAUSIBLE))


def without_unknown(height: HeightMap, mirror: Mirror) -> HeightMap:
    """The height with pixels flagged SINGULAR whose total sigma exceeds a quarter of the mirror's length."""
    unknown = height.good & (height.total_sigma > UNKNOWN * mirror.length)
    flags = height.flags | np.where(unknown, np.uint16(HeightFlag.SINGULAR), np.uint16(0))
    return replace(height, flags=flags) if unknown.any() else height
