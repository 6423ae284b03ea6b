"""Heights less rest, less what the load and the rig's motion since rest add to them, as the map shows it.

An anchor counts as at rest, where a load makes it sink; a rig that moved between both captures moves heights.
Both are fitted outside the contacts (`optolever.contact.load_fit`) and taken off. Where the fit leaves much
more than noise, the load is none of a half-space or layer, or the mirror changed as a whole: then nothing is
taken off, and all of it is in the map's modes. Contacts of a map without rest: less the same fit.
"""

from dataclasses import replace

import numpy as np

from optolever.arrays import Floats
from optolever.contact import Contact, Surface, elastic_fits, load_fit, regions
from optolever.contact import contacts as figures
from optolever.notices import Judged
from optolever.scene import Layer, Scene

from .heightmap import REST_NOISE, HeightFlag, HeightMap, coarse_step, filled
from .problem import Problem
from .solver.newton import State
from .uncertainty.sources import anchor_response

__all__ = ["SAG", "contacts", "free_mode", "less_sag", "surface_of"]

SAG = "sag under the load, motion since rest"
_MISFIT = 6.0  # noises: half-spaces, layers and dents that fade leave 5, a body that bulges 8
_MOVED = 3.0  # standard deviations of motion
_CURE_SAG = (
    "total_sigma includes it; most likely the silicone is thin: give [layer] thickness_mm in the scene"
)
_CURE_MOVED = (
    "corrected, and total_sigma includes the rest; clamp the rig and capture the mirror at rest again"
)


def less_sag(height: HeightMap, problem: Problem, state: State, scene: Scene) -> HeightMap:
    """A map less rest without its sag and the rig's motion, or with both in its modes."""
    held = np.zeros(problem.data.mask.shape, np.bool_)
    held.flat[state.rows.pixel] = state.share > 0
    held = problem.to_image(held, False) & np.isfinite(height.z)
    anchors = np.stack([height.x[held], height.y[held]], axis=-1)
    surface = replace(surface_of(height, free_mode(problem, state)), anchors=anchors)
    found = load_fit(surface, scene.layer, solid=not scene.open_air)
    if found is None:
        return _wider(height)
    motion = float(np.linalg.norm(found.motion)) / np.sqrt(max(found.motion.size, 1))
    name = "The rig moved between rest and press, by so many of its standard deviations"
    moved = Judged("motion", motion, _MOVED, name, _CURE_MOVED)
    name = "Outside the contacts the mirror does not sink as under a load; residual over noise"
    load = Judged("load", found.beyond, _MISFIT, name, _CURE_SAG)
    height = replace(height, tests=(*height.tests, moved, load))
    less = surface.less(found)
    assert less.modes is not None
    modes, z = np.asarray(less.modes, np.float64), np.asarray(less.z, np.float64)
    if load.fails:
        few = slice(None, None, surface.step), slice(None, None, surface.step)
        wide = np.zeros((0, *height.z[few].shape))
        wide = wide if height.modes is None else np.asarray(_wider(height).modes, np.float64)
        modes, z = np.concatenate([wide, (height.z - z)[None, *few]]), height.z
        return replace(_with_own(height, modes, surface.step), z=z)
    own = _with_own(height, modes, surface.step, _rest_share(height) * found.noise)
    return replace(own, z=z)


def _wider(height: HeightMap) -> HeightMap:
    """The map whose own modes are as large as its heights, where too little of it rests to measure them."""
    good = height.good & np.isfinite(height.z)
    if not height.own or height.modes is None or not good.any():
        return height
    own = np.square(height.modes[-height.own :], dtype=np.float64).sum(axis=0)
    wider = 1.4826 * float(np.median(np.abs(height.z[good]))) / float(np.sqrt(np.mean(own)))
    cure = "total_sigma includes it; press on less of the mirror"
    name = "Too little of the mirror is untouched to measure the rig's motion; sigma of it, times the usual"
    modes = height.modes.copy()
    modes[-height.own :] *= max(wider, 1.0)
    return replace(height, modes=modes, tests=(*height.tests, Judged("untouched", wider, _MOVED, name, cure)))


def surface_of(height: HeightMap, free: Floats | None = None) -> Surface:
    """The arrays of a map for `optolever.contact`; free (H, W): z's free mode."""
    step = coarse_step(height.z.shape) if height.modes is None else height.modes_step
    return Surface(
        *(height.x, height.y, height.z, height.sigma, height.good),
        free=free,
        modes=height.modes,
        step=step,
        motions=height.own,
        displacement=height.displacement,
    )


def free_mode(problem: Problem, state: State) -> Floats:
    """Change of z (H, W) where all known values change alike, of size 1 (median)."""
    data = problem.data
    moved = anchor_response(problem.labels, state, np.ones(state.rows.pixel.size))
    if data.rays.logarithmic:
        moved = moved * data.distance(state.w)
    mode = problem.to_image(np.where(data.mask, moved, np.nan), np.nan) * problem.rays.inner_directions[2]
    size = np.nanmedian(np.abs(mode))
    return np.asarray(mode / (size if size > 0 else 1.0))


def _rest_share(height: HeightMap) -> float:
    """Of the noise's variance that is the rest capture's, median."""
    good, rest = height.good, [name.startswith("rest ") for name in height.references]
    if height.shared is None or not any(rest) or not good.any():
        return 0.0
    return float(np.median(np.square(height.shared[rest][0][good] / height.sigma[good])))


def _with_own(height: HeightMap, modes: Floats, step: int, of_rest: Floats | None = None) -> HeightMap:
    """The map whose own errors are the last of these modes, after those of its rig; of_rest: the part of
    their covariance, which is 1, by noise of the rest capture."""
    common, count = height.count - height.own, len(modes)
    own, kept = count - common, len(height.sources) - (height.own > 0)
    shares = np.zeros((kept + 2, count, count))
    if height.shares is not None:
        shares[:kept, :common, :common] = height.shares[:kept, :common, :common]
    shares[-2, common:, common:] = 0.0 if of_rest is None else of_rest
    shares[-1, common:, common:] = np.eye(own) - shares[-2, common:, common:]
    moves = height.displacement
    if moves is not None:
        moves = np.concatenate([moves[:common], np.zeros((own, 2, 3)), moves[height.count :]])
    return replace(
        height,
        modes=filled(modes),
        modes_step=step,
        sources=(*height.sources[:kept], REST_NOISE, SAG),
        shares=shares,
        displacement=moves,
        own=own,
    )


def contacts(height: HeightMap, layer: Layer | None = None) -> tuple[Contact, ...]:
    """Contacts, the deepest first: cells deeper than half of a peak that rises above the surface at rest by
    six standard deviations; last those whose depth is below three of its own (at a hole, or by the rig's
    errors); layer: elastic, for the forces.

    In a map without a rest capture, errors of the rig that show in most of the map are removed first. Only
    pixels without a flag, or with STEEP alone, are used.
    """
    usable = (height.flags & ~np.uint16(HeightFlag.STEEP)) == 0
    usable &= np.isfinite(height.z) & np.isfinite(height.sigma)
    if not usable.any():
        return ()
    surface = replace(surface_of(height, height.free), good=usable)
    if not height.against_rest and (height.count or height.free is not None):
        surface = replace(surface, motions=height.count)
        found = load_fit(surface, layer, solid=height.free is None)
        surface = surface if found is None else surface.less(found)
    dents = regions(surface)
    return figures(surface, dents, layer, elastic_fits(surface, dents, layer))
