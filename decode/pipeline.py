"""One capture: sample -> noise, misfit, effects -> tables -> maps, block by block."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray

from optolever.blocks import over_blocks, threads
from optolever.kernels import F32, F64, I64
from optolever.notices import Notice
from optolever.patterns import STRIPES, Sequence

from .codes.bits import bit_tables
from .codes.fringe import Misfit, bent, fringe_table, measure_misfit, straightened, three_step_aliasing
from .codes.lookup import Lines, LookUp, Table, beside, lookup_rows, prepare, table_of
from .codes.orders import Orders, order_table
from .correspondence import Correspondence, Flag
from .diagnosis.tests import Decoded, Verdict, judged
from .diagnosis.windows import EVERY
from .effects import View, lag, leak, motion, shared, stripes
from .frames import Light, Settings, raw_at, sample_places
from .neighbours import BLURRED, EITHER, HALO, SETTLE, Beside, Block, Result, axis_limits, neighbours, settle
from .noise import Noise, Sample, fit_noise
from .pixels import AxisNumbers, AxisTable, Maps, pixel_rows
from .plan import AxisPlan, Fringe, Plan, constraints, plan
from .profile import AxisProfile, Estimates, Sampled
from .rims import beyond_rims

__all__ = ["Prepared", "applied", "compile_neighbours", "estimated", "holds", "prepared"]

Mask = NDArray[np.bool_] | None
#: Runs of the sample, times as many of one for look-ups, motion and noise in common; fewest pixels for an
#: estimate; median of chi2 with one degree of freedom.
_RUNS, _WIDER, _FEWEST, _MEDIAN = 64, 4, 64, 0.4549
#: In turn: the levels are corrected before the places are judged.
_EFFECTS = (lag, motion, leak, stripes, shared)
#: Side of the neighbourhood that lies in a mask where the order of frames is tested.
_BLOCK = 11
#: Bytes of a block's lines, about those of a core's cache.
_CACHE = 1 << 20
#: Share of the usual span of levels above which a pixel is lit.
_LIT = 0.15
#: Change of a statistic from which on a profile no longer holds; of sigma from which on a notice says so.
_CHANGED, _NOTICED = 2.0, 1.5
#: Share of the good pixels below which a profile no longer holds.
_FEWER = 0.9


class Prepared(NamedTuple):
    """Decoder of a profile: kernels' tables, degrees of freedom of chi2, numbers of the axes for the
    neighbours, tables of look-ups (None: without), correction of the levels by a lag (None: without)."""

    axes: tuple[AxisPlan, ...]
    profile: Estimates
    tables: tuple[AxisTable, ...]
    dof: int
    limits: F32
    look_ups: tuple[Table | None, ...]
    matrix: F64 | None


def lit_pixels(light: Light, inside: Mask, wider: int = 1) -> tuple[I64, NDArray[Any]]:
    """Lit pixels of the mask, in runs along rows: places (K, 2), raw levels (N, K)."""
    places = sample_places((light.raw.shape[1], light.raw.shape[2]), wider * _RUNS)
    if inside is not None:
        places = places[inside[tuple(places.T)]]
    raw = raw_at(light, places)
    ends = (one.astype(light.raw.dtype) for one in (raw.min(axis=0), raw.max(axis=0)))
    low, high = (np.nan_to_num(light.linear(one), nan=light.white) for one in ends)
    span = high - low
    least = _LIT * np.quantile(span[span >= 0.5 * span.max()], 0.5) if span.size and span.max() > 0 else 0.0
    lit = span > least
    return (places, raw) if lit.all() else (places[lit], raw[:, lit])


def lit_sample(light: Light, inside: Mask, wider: int = 1) -> Sample:
    """With their linear levels."""
    places, raw = lit_pixels(light, inside, wider)
    return Sample(places, light.linear(raw), raw)


def estimated(
    light: Light, sequence: Sequence, settings: Settings, mask: Mask
) -> tuple[Correspondence, Prepared | None]:
    """Estimate a profile, and decode by it; pixels that the tests refuse estimate nothing. None: all are
    refused."""
    found, ready, verdict = _estimated(light, sequence, settings, mask, mask)
    if verdict.wrong.any() and not verdict.wrong.all():
        inside = ~verdict.wrong if mask is None else mask & ~verdict.wrong
        other, rest, _ = _estimated(light, sequence, settings, mask, inside)
        if _moved(rest):
            return replace(found, tests=verdict.tests), ready  # it is the cause, and sigma holds it
        found, ready = other, rest
    return _refused(found, verdict), None if verdict.wrong.all() else ready


def applied(light: Light, sequence: Sequence, ready: Prepared, mask: Mask) -> Correspondence:
    """Decode all pixels by a prepared decoder, and test whether the frames agree with their description."""
    return _refused(*_tested(light, sequence, ready, mask))


def _tested(light: Light, sequence: Sequence, ready: Prepared, mask: Mask) -> tuple[Correspondence, Verdict]:
    found, residual = _mapped(light, ready, mask)
    if sequence.packing is not None and sequence.packing.stripes == "unknown":
        found = replace(found, common_u=max(STRIPES["rgb"]))
    around = None if mask is None else scipy.ndimage.minimum_filter(mask, _BLOCK)  # whole blocks of the mask
    effects = ready.profile.effects
    some = any(effect.name in ("lag", lag.LADDER) for effect in effects)
    numbers = _noise(ready), ready.tables, lag.matrix(effects, plan(sequence)) if some else None
    short = next((e.value for e in effects if e.name == lag.LADDER and sequence.packing is not None), np.nan)
    return found, judged(Decoded(found, residual, light, sequence, *numbers, _moved(ready), around, short))


def _refused(found: Correspondence, verdict: Verdict) -> Correspondence:
    flags = found.flags
    if verdict.wrong.any():
        flags = flags | np.uint16(Flag.WRONG_FRAME) * verdict.wrong
    return replace(found, flags=flags, notices=(*verdict.notices, *found.notices), tests=verdict.tests)


def _moved(ready: Prepared) -> bool:
    return any(effect.name == "motion" for effect in ready.profile.effects)


def _estimated(
    light: Light, sequence: Sequence, settings: Settings, mask: Mask, inside: Mask
) -> tuple[Correspondence, Prepared, Verdict]:
    """Decoded in a mask, by a profile of the pixels inside of another."""
    looked_up = any(axis.looked_up for axis in plan(sequence).axes)
    wide = lit_sample(light, inside, _WIDER)
    sample = wide if looked_up else lit_sample(light, inside)
    ready = prepared(sequence, settings, _estimate(light, sequence, settings, sample, wide))
    ready = ready._replace(profile=ready.profile._replace(sampled=_statistics(light, ready, sample.raw)))
    found, verdict = _tested(light, sequence, ready, mask)
    return found, ready, verdict


def _estimate(
    light: Light, sequence: Sequence, settings: Settings, sample: Sample, wide: Sample
) -> Estimates:
    """Noise and misfits, then every effect: one corrects the levels, the others add to the variance."""
    p = plan(sequence)
    if settings.noise is not None:
        noise = Noise(settings.noise**2 + light.rounding, settings.gain)
    else:
        noise = fit_noise(p, sample, light.rounding)
    known = noise if settings.noise is not None or constraints(p, len(sequence)) else None
    look_ups = [
        prepare(sequence, axis, light, wide, known, settings) if axis.looked_up else None for axis in p.axes
    ]
    # residuals of a table are noise; differences of neighbours between grey values of cells are not
    noise = next((one.noise for one in look_ups if one is not None and one.noise is not None), noise)

    def viewed(profile: Estimates, sample: Sample, wide: Sample) -> tuple[View, Estimates]:
        profile = _with_misfits(profile, sequence, settings, sample, look_ups)
        if settings.noise is None and any(axis.fringes[1:] for axis in p.axes):
            found = _places(light, prepared(sequence, settings, profile), sample)
            every = zip(profile.axes, p.axes, found, strict=True)
            profile = profile._replace(axes=tuple(_between(*one, sample, noise) for one in every))

        def places(of: Sample) -> F64:
            return _places(light, prepared(sequence, settings, profile), of)

        return View(p, noise, sample, wide, places, lens), profile

    lens = BLURRED if settings.lens_px is None else 0.0
    nothing = Estimates(noise, (), (), None, Sampled(0.0, 0.0, 0.0), ())
    view, profile = viewed(nothing, sample, wide)
    more = np.zeros(len(p.axes))
    for effect in _EFFECTS:
        found = effect.correct(view)
        if found is None:
            continue
        profile = profile._replace(effects=profile.effects + found.effects, shared=found.shared)
        if found.matrix is not None:
            matrix = found.matrix.astype(np.float32)
            view, profile = viewed(profile, *(replace(s, levels=matrix @ s.levels) for s in (sample, wide)))
        more += found.variance
    own = tuple(axis._replace(variance=float(v)) for axis, v in zip(profile.axes, more, strict=True))
    profile = profile._replace(axes=own)
    return profile._replace(notices=_notices(profile, p.axes, view))


def _with_misfits(
    profile: Estimates, sequence: Sequence, settings: Settings, sample: Sample, look_ups: list[LookUp | None]
) -> Estimates:
    p, noise, own = plan(sequence), profile.noise, []
    for axis, look_up in zip(p.axes, look_ups, strict=True):
        misfits = tuple(_misfit(fringe, p, axis, sample, noise, settings) for fringe in axis.fringes)
        own.append(AxisProfile(misfits, _deviation(axis, sample, noise), 0.0, look_up))
    return profile._replace(axes=tuple(own))


def _places(light: Light, ready: Prepared, sample: Sample) -> F64:
    """Places (A, K) of sample pixels, pattern px; NaN where flagged."""
    if not len(sample.places):
        return np.zeros((len(ready.axes), 0))
    maps = _sampled(light, ready, sample.raw)
    return np.where(maps.flags[0] == 0, maps.place[:, 0].astype(np.float64), np.nan)


def _misfit(
    fringe: Fringe, p: Plan, axis: AxisPlan, sample: Sample, noise: Noise, settings: Settings
) -> Misfit:
    ends = [] if axis.code is None else axis.code.pairs()
    ends += [(p.white, p.black)] if min(p.white, p.black) >= 0 else []
    found = measure_misfit(fringe, sample, noise)
    if np.isnan(noise.read2_sigma):  # given: each pixel is judged by its neighbourhood alone
        found = found._replace(scale=1.0, terms=np.zeros_like(found.terms))
    if p.packing is not None:
        found = found._replace(scale=found.scale * p.packing.wider**2)
    display = settings.display
    if display is not None:
        return bent(fringe, display, settings.blur, found)
    return found._replace(variance=found.variance + three_step_aliasing(fringe, ends, sample, noise))


#: Causes of a wide sigma, and their cures.
_MOTION, _GAMMA, _LAG = "motion or flicker between the frames", "the display's gamma", "the display's lag"
_LEAK = "the mix of the colours, which is not known better"
_CURES = {
    _MOTION: "hold the mirror still, and expose for whole periods of the display's light",
    _GAMMA: "measure it once: optolever response",
    _LAG: "measure it once: optolever camera sync; or wait longer before each picture",
    _LEAK: "measure it again: optolever response --colour; or show the patterns in grey",
}


def _notices(profile: Estimates, axes: tuple[AxisPlan, ...], view: View) -> tuple[Notice, ...]:
    """Motion; else what costs a factor of 1.5 in sigma or more, its largest part by name."""
    for effect in profile.effects:
        if effect.name == "motion":
            name = f"the mirror moved while the frames were taken, by {effect.value:.2g} pattern px per frame"
            cure = "sigma includes it; hold the mirror still, or show fewer frames"
            return (Notice.plain(name, cure),)
        if effect.name == stripes.NAME:
            off = f"bits and fringes are {abs(effect.value):.2g} cells apart"
            name = f"the display's stripes are not those stated: {off}"
            cure = "sigma includes it; state their order: show --colour rgb, bgr or none"
            return (Notice.plain(name, cure),)
        if effect.name == lag.LADDER and view.plan.packing is None:
            share = f"{100 * effect.value:.2g} %"
            name = f"a lag of about {share} of the display, which three steps take for places"
            cure = "heights may err by more than sigma; show four steps, or wait longer before each picture"
            return (Notice.plain(name, cure),)
    worst, cause, lagged = 1.0, "", any(effect.name == "lag" for effect in profile.effects)
    for axis, own in zip(axes, profile.axes, strict=True):
        if not axis.fringes or not own.misfits:
            continue
        fringe, misfit = axis.fringes[-1], own.misfits[-1]
        variances = _phase_variance(fringe, view.sample, profile.noise)
        if not np.isfinite(variances).any():
            continue
        noise = float(np.nanmedian(variances))
        parts = {
            _MOTION: (misfit.scale - 1) * noise,
            _GAMMA: misfit.variance,
            _LAG if lagged else _LEAK: own.variance / fringe.period**2,
        }
        factor = (1 + sum(parts.values()) / max(noise, 1e-30)) ** 0.5
        if factor > worst:
            worst, cause = factor, max(parts, key=lambda name: parts[name])
    if worst < _NOTICED:
        return ()
    name = f"sigma is {worst:.2g} times wider than noise alone, most likely because of {cause}"
    return (Notice.plain(name, _CURES[cause]),)


def _phase_variance(fringe: Fringe, sample: Sample, noise: Noise) -> F64:
    """Variance (cycles^2) of the sample's phases by noise."""
    o, c, s = fringe.inverse @ sample.levels[list(fringe.index)].astype(np.float64)
    own = noise.variance(o) * np.square(fringe.inverse[1]).sum()
    return np.asarray(own / np.maximum(c * c + s * s, 1e-6) / (2 * np.pi) ** 2)


def _between(own: AxisProfile, axis: AxisPlan, place: F64, sample: Sample, noise: Noise) -> AxisProfile:
    """Add the variance of the phases by which coarser periods contradict the place beyond noise."""
    most, fine = 0.0, axis.fringes[-1].period if axis.fringes else 1.0
    for fringe, misfit in zip(axis.fringes[:-1], own.misfits, strict=False):
        _, c, s = fringe.inverse @ sample.levels[list(fringe.index)].astype(np.float64)
        variance = misfit.scale * _phase_variance(fringe, sample, noise)
        away = straightened(np.arctan2(s, c) / (2 * np.pi), misfit) - place / fringe.period
        away -= np.rint(away)
        ok = np.isfinite(away)
        if np.count_nonzero(ok) >= _FEWEST:
            of_both = float(np.median(away[ok] ** 2)) / _MEDIAN / (1 + (fine / fringe.period) ** 2)
            most = max(most, of_both - float(np.median(variance[ok])))
    return own._replace(misfits=tuple(m._replace(variance=max(m.variance, most)) for m in own.misfits))


def _deviation(axis: AxisPlan, sample: Sample, noise: Noise) -> float:
    """Of close periods: deviation of a sample over the 5 % quantile of the finest fringe's amplitude; else
    0."""
    if axis.code is not None or len(axis.fringes) < 2 or axis.fringes[0].period >= axis.extent:
        return 0.0
    levels = sample.levels[list(axis.fringes[-1].index)].astype(np.float64)
    levels = levels[:, np.isfinite(levels).all(axis=0)]
    if not levels.size:
        return 1.0
    o, c, s = axis.fringes[-1].inverse @ levels
    return float(np.sqrt(noise.variance(np.median(o))) / max(np.quantile(np.hypot(c, s), 0.05), 1e-6))


def _orders(axis: AxisPlan, own: AxisProfile) -> Orders:
    if own.deviation == 0:
        return Orders(np.zeros((1, 1), np.float32), np.float32(1), np.float32(1))
    most = max(misfit.variance for misfit in own.misfits)
    scale = max(misfit.scale for misfit in own.misfits)
    noise2 = scale * own.deviation**2 * 4 / len(axis.fringes[-1].index) / (2 * np.pi) ** 2
    return order_table(tuple(f.period for f in axis.fringes), axis.extent, float(np.sqrt(noise2 + 2 * most)))


def prepared(sequence: Sequence, settings: Settings, profile: Estimates) -> Prepared:
    """The decoder of a profile."""
    p = plan(sequence)
    axes, own = p.axes, profile.axes
    some = any(effect.name == "lag" for effect in profile.effects)
    matrix = lag.matrix(profile.effects, p) if some else None
    tables = tuple(
        AxisTable(
            *fringe_table(axis.fringes, own[k].misfits, matrix),
            code,
            _orders(axis, own[k]),
            _numbers(axis, own[k], k),
            axis.looked_up,
            own[k].deviation > 0,
        )
        for k, (axis, code) in enumerate(zip(axes, bit_tables(p, list(axes)), strict=True))
    )
    dof = sum(len(f.index) - 3 for axis in axes if not axis.looked_up for f in axis.fringes)
    dof += sum(len(axis.fringes) - 1 for axis, one in zip(axes, own, strict=True) if one.deviation > 0)
    look_ups = tuple(
        None if one.look_up is None else table_of(sequence, axis, one.look_up)
        for axis, one in zip(axes, own, strict=True)
    )
    dof += sum(table.dof for table in look_ups if table is not None)
    limits = np.stack([axis_limits(axis, settings.lens_px, settings.on_cells) for axis in axes])
    for table, line in zip(look_ups, limits, strict=True):
        line[0] = line[0] if table is None else table.jump
    return Prepared(axes, profile, tables, dof, limits, look_ups, matrix)


def _numbers(axis: AxisPlan, own: AxisProfile, number: int) -> AxisNumbers:
    factor = 2 / len(axis.fringes[-1].index) if axis.fringes else 0.5
    beyond = max(1 - axis.fringes[0].period / axis.extent, 0) if axis.fringes and not axis.code else 0
    some: list[Any] = [np.float32(one) for one in (factor, own.variance, axis.extent, beyond)]
    return AxisNumbers(*some, *[np.int32(_either(axis, number))])


def _either(axis: AxisPlan, number: int) -> int:
    """Flag where two orders fit: of cells as large as a period, and of look-ups but sweeps, the neighbours
    choose."""
    code = axis.code
    if axis.looked_up and axis.stripes is None:
        return int(EITHER[number])
    if code is None or len(axis.fringes) != 1 or code.cell < axis.fringes[0].period * (1 - 1e-6):
        return int(Flag.ORDER_DOUBTFUL)
    return int(EITHER[number])


def _period(axis: AxisPlan, table: Table | None) -> float:
    """Between two places that fit, px: a coarsest period; of levels four jumps."""
    return axis.fringes[0].period if axis.fringes else 4 * table.jump if table is not None else 1.0


def _statistics(light: Light, ready: Prepared, raw: NDArray[Any]) -> Sampled:
    """Of sample pixels (N, K), by the pixel kernel alone."""
    if not raw.shape[1]:
        return Sampled(0.0, 0.0, 0.0)
    maps = _sampled(light, ready, raw)
    good = maps.flags[0] == 0
    chi2 = float(np.median(maps.chi2[0][good])) / ready.dof if ready.dof and good.any() else 0.0
    return Sampled(float(good.mean()), chi2, float(np.median(maps.least[0])))


def _sampled(light: Light, ready: Prepared, raw: NDArray[Any]) -> Maps:
    """Sample pixels (N, K) decoded as a row of an image."""
    few = replace(light, raw=np.ascontiguousarray(raw)[:, None])  # in another order all is compiled anew
    maps, looked_up = _maps(len(ready.axes), 1, raw.shape[1]), _looked_up(few, ready, 0, 1)
    pixel_rows(few.numbers, _noise(ready), ready.tables, looked_up, (0, 1, 0, 1), 0, maps)
    return maps


def _noise(ready: Prepared) -> tuple[np.float32, np.float32]:
    return np.float32(ready.profile.noise.read2), np.float32(ready.profile.noise.gain)


def _maps(axes: int, rows: int, width: int) -> Maps:
    return Maps(*_block(axes, rows, width), *np.zeros((3, rows, width), np.float32))


def _looked_up(light: Light, ready: Prepared, start: int, stop: int) -> Lines:
    """Lines of the axes that are looked up; one pixel without any."""
    axes = len(ready.axes)
    some = any(table is not None for table in ready.look_ups)
    shape = (axes, stop - start, light.raw.shape[2]) if some else (1, 1, 1)
    place, variance, amplitude, offset, error, chi2 = (np.zeros(shape, np.float32) for _ in range(6))
    out = Lines(place, variance, amplitude, offset, error, chi2, np.zeros(shape, np.int32))
    light = _corrected(light, ready, light.raw[:, start:stop]) if some else light
    for a, table in enumerate(ready.look_ups):
        if table is not None:
            either, lines = int(ready.tables[a].numbers.either), Lines(*(one[a] for one in out))
            lookup_rows(light, ready.profile.noise, table, either, lines)
    return out


def _corrected(light: Light, ready: Prepared, raw: NDArray[Any]) -> Light:
    """Light of these pixels (N, ...), less the lag."""
    if ready.matrix is None:
        return replace(light, raw=raw)
    levels = np.tensordot(ready.matrix, light.linear(raw), 1).astype(np.float32)
    levels = np.where(np.isnan(levels), np.float32(np.inf), levels)
    return Light(levels, np.inf, np.zeros(0, np.float32), light.rounding)


def _beside(light: Light, ready: Prepared, table: Table, row: int) -> Beside:
    """For settle(): what neighbours may choose of a look-up; row: of the image, the block's first."""

    def look_up(
        at: tuple[NDArray[np.intp], ...], place: F32, other: F32
    ) -> tuple[F32, F32, NDArray[np.bool_]]:
        some = _corrected(light, ready, light.raw[:, at[0] + row, at[1]])
        found, variance, fits = beside(some, ready.profile.noise, table, place, other)
        return found.astype(np.float32), variance.astype(np.float32), fits

    return look_up


def holds(light: Light, ready: Prepared, mask: Mask) -> tuple[Notice, ...]:
    """Why a profile no longer holds for these frames, by sample pixels; empty: it does."""
    known, now = ready.profile.sampled, _statistics(light, ready, lit_pixels(light, mask)[1])
    contrast = now.amplitude / max(known.amplitude, 1e-6)
    changes = (
        ("share of good pixels", known.good, now.good, now.good < _FEWER * known.good),
        ("noise of the residuals", known.chi2, now.chi2, now.chi2 > _CHANGED * max(known.chi2, 0.5)),
        ("contrast, levels", known.amplitude, now.amplitude, not 0.5 < contrast < 2),
    )
    return tuple(
        Notice.plain(
            f"the rig's profile no longer fits, {name} was {old:.2g}, is {new:.2g}",
            "this capture is decoded by its own; store that: optolever decode --save-profile",
        )
        for name, old, new, changed in changes
        if changed
    )


def _mapped(light: Light, ready: Prepared, mask: Mask) -> tuple[Correspondence, F32]:
    """Decoded pixels, and the residuals (chi2) of every EVERY-th one."""
    _, rows, cols = light.raw.shape
    axes = len(ready.axes)
    # one piece of memory: the system clears small ones anew for every capture
    maps = np.empty((2 * axes + 3, rows, cols), np.float32)
    coordinate, sigma, (amplitude, offset, error) = maps[:axes], maps[axes : 2 * axes], maps[2 * axes :]
    flags = np.empty((rows, cols), np.uint16)
    residual = np.empty((-(-rows // EVERY), -(-cols // EVERY)), np.float32)
    most = int(np.clip(_CACHE // (4 * cols * (2 * axes + 2)), 16, 128))
    open_orders = any(table.numbers.either >= EITHER[0] for table in ready.tables)
    halo = HALO + SETTLE if open_orders else HALO
    result = Result(coordinate, sigma, flags)
    periods = np.array([_period(*one) for one in zip(ready.axes, ready.look_ups, strict=True)], np.float32)

    def work(first: int, last: int) -> None:
        """Blocks of a thread, from above, of one size, in one memory: the rows shared with the one before
        move up."""
        size, done = -(-(last - first) // -(-(last - first) // most)), max(first - halo, 0)
        memory, before = _block(axes, size + 2 * halo, cols), first
        for start in (*range(first, last - size, size), last - size):
            stop, low, high, block = start + size, start - halo, min(start + size + halo, rows), memory
            for own in block if start > before else ():
                own[..., : before - start, :] = own[..., start - before :, :].copy()
            before = start
            if done < high:
                out, looked_up = Maps(*block, amplitude, offset, error), _looked_up(light, ready, done, high)
                numbers, which = (light.numbers, _noise(ready)), (done, high, first, last)
                pixel_rows(*numbers, ready.tables, looked_up, which, done - low, out)
                if mask is not None:
                    block.flags[done - low : high - low][~mask[done:high]] |= np.uint16(Flag.INVALID)
                done = high
            some = np.arange(-(-start // EVERY), -(-stop // EVERY))
            residual[some] = block.chi2[EVERY * some - low, ::EVERY]
            block.flags[: max(-low, 0)] = block.flags[high - low :] = Flag.INVALID
            if open_orders:
                looks = [None if one is None else _beside(light, ready, one, low) for one in ready.look_ups]
                block, low = settle(block, periods, looks), low + SETTLE
            image = max(-low, 0), min(rows - low, len(block.flags))
            neighbours(block, image, ready.dof, ready.limits, start, result)
            if open_orders:
                error[start:stop][(flags[start:stop] == 0) & (error[start:stop] == 1)] = 0

    cuts = np.unique(np.linspace(0, rows, min(threads(), max(rows // 32, 1)) + 1).astype(int)).tolist()
    over_blocks(work, cuts)
    beyond_rims(result, amplitude, float(ready.limits[:, 6].min()))
    none = np.full((rows, cols), np.nan, np.float32), np.full((rows, cols), np.inf, np.float32)
    found = {axis.axis: (coordinate[a], sigma[a]) for a, axis in enumerate(ready.axes)}
    (u, sigma_u), (v, sigma_v) = found.get("u", none), found.get("v", none)
    profile = ready.profile
    maps_of = u, v, sigma_u, sigma_v, flags, amplitude, offset, error
    return Correspondence(*maps_of, profile.notices, profile.shared), residual


def compile_neighbours() -> None:
    """Compile the kernels of neighbours, which are the same for all frames, while another process compiles
    the pixels'."""
    nothing = np.zeros((1, 1, 8), np.float32)
    limits, result = np.ones((1, 6), np.float32), Result(nothing, nothing, np.zeros((1, 8), np.uint16))
    neighbours(_block(1, 2 * HALO + 1, 8), (0, 2 * HALO + 1), 1, limits, 0, result)


def _block(axes: int, rows: int, cols: int) -> Block:
    place, variance, amplitude = (np.zeros((axes, rows, cols), np.float32) for _ in range(3))
    chi2, flags = np.zeros((rows, cols), np.float32), np.zeros((rows, cols), np.uint16)
    return Block(place, variance, amplitude, chi2, flags)
