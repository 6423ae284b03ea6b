"""One axis: which steps its frames ask for, and their chain over a block of rows."""

import math
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from optolever.patterns import Sequence

from .codes.gray import CodePlan, code_plan, decode_code, read_code
from .codes.lookup import Table, lookup_rows, prepare
from .codes.phase import Periods, periods_of
from .codes.unwrap import Orders, climb, order_table, unwrap_close
from .display import table_rounding
from .estimate import Estimate
from .flags import DOUBT, Into, Limits, Shared, limits_of, merge
from .frames import Light
from .plan import AxisPlan, Fringe, Plan, constraints, plan, raster_axes
from .profile.noise import Noise, Sample
from .profile.unlike import Before, misfit_between, misfit_within, whole
from .spatial import Raw

__all__ = ["AxisDecoder", "AxisOptions", "Shot", "axis_decoders"]

#: Pixels that tell a variance (18 %), and that are asked (a fifth surely); rounds in which what periods
#: contradict each other by is found, as orders are listed within it.
_FEWEST, _ASKED, _ROUNDS = 64, 450, 6


@dataclass(frozen=True, slots=True)
class AxisDecoder:
    """What turns rows of frames into coordinates of one axis.

    periods   of the fringes, with the variance that rounded grey values and misfit leave
    limits    beyond which pixels are flagged; jump: largest second difference of neighbours, stripe: the
              finest one of a code, pattern px; per_turn: turns of the finest fringe in a px, 0 without one;
              between: variance (turns^2) of a phase by what periods contradict each other by
    """

    axis: AxisPlan
    light: Light
    noise: Noise
    code: CodePlan | None
    orders: Orders | None
    table: Table | None
    periods: Periods | None
    limits: Limits
    jump: float
    stripe: float
    per_turn: float = 0.0
    between: float = 0.0

    def decode(self, rows: tuple[int, int], raw: Raw, first: bool, shared: Shared) -> None:
        """Rows start..stop: coordinates and variances into the axis' maps, the rest into the shared ones."""
        into = Into(raw.coordinate, raw.variance, self.limits, first, shared)
        if self.table is not None:
            merge(self._looked_up(self.table, rows, raw), self.noise, rows, into)
        elif self.periods is None:
            assert self.code is not None
            decode_code(self.light, self.noise, self.code, rows, into)
        elif self.orders is not None:
            unwrap_close(self.light, self.noise, self.periods, self.orders, rows, into)
        else:
            climb(self.light, self.noise, self.periods, self.axis.extent, self.code, rows, into)

    def _looked_up(self, table: Table, rows: tuple[int, int], raw: Raw) -> Estimate:
        """Rows start..stop by a table, of a code from its cells on."""
        part = slice(*rows)
        estimate = Estimate.empty(rows[1] - rows[0], self.light.raw.shape[2])
        estimate = estimate._replace(coordinate=raw.coordinate[part], variance=raw.variance[part])
        if self.code is not None:
            read_code(self.light, self.noise, self.code, rows, estimate)
        lookup_rows(self.light, self.noise, table, rows, estimate)
        return estimate


@dataclass(frozen=True, slots=True)
class Shot:
    """Frames of one exposure, what they show, the camera's noise, and pixels that see the pattern; cells:
    whether it was shown on cells."""

    light: Light
    sequence: Sequence
    plan: Plan
    noise: Noise
    lit: Sample
    cells: bool


class AxisOptions(NamedTuple):
    """subpixel, blur (cells, None: unknown): see decode; known: whether the noise is, else, where no rule of
    the frames tells it, a look-up measures it; before: what frames hold of earlier ones."""

    subpixel: bool = False
    known: bool = False
    blur: float | None = None
    before: Before = Before()


def axis_decoders(shot: Shot, options: AxisOptions) -> list[AxisDecoder]:
    """Choose the steps for each axis. InputError where its frames tell no place."""
    known = options.known or bool(constraints(shot.plan, len(shot.sequence)))
    axes = raster_axes(shot.sequence) or shot.plan.axes
    return [_decoder(axis, shot, options._replace(known=known)) for axis in axes]


def _sampled_light(light: Light, places: NDArray[np.int64]) -> Light:
    """Pixels at places (K, 2) as frames of one row."""
    row, col = places.T
    return replace(light, raw=np.ascontiguousarray(light.raw[:, row, col][:, None, :]))


def _decoder(axis: AxisPlan, shot: Shot, options: AxisOptions) -> AxisDecoder:
    light, noise = shot.light, shot.noise
    code = None if axis.code is None else code_plan(axis.code, shot.plan, noise, shot.lit)
    if axis.looked_up or (options.subpixel and code is not None and not axis.fringes):
        return _by_table(axis, code, shot, options)
    if axis.fringes:
        fine = axis.fringes[-1]
        jump, stripe, per_turn, factor = fine.period / 4, math.inf, 1 / fine.period, 2 / len(fine.index)
    else:
        assert code is not None
        jump = stripe = 2.0 * float(code.cell)
        per_turn, factor = 0.0, 0.5
    limits = limits_of(axis.extent, factor, _freedom(axis, code), light.white)
    found = AxisDecoder(axis, light, noise, code, None, None, None, limits, jump, stripe, per_turn)
    return _by_fringes(found, shot, options.before) if axis.fringes else found


def _by_table(axis: AxisPlan, code: CodePlan | None, shot: Shot, options: AxisOptions) -> AxisDecoder:
    """Known levels are looked up."""
    light, noise, lit = shot.light, shot.noise, shot.lit
    cells = None if code is None else _cells(code, light, noise, lit)
    known = noise if options.known else None
    table = prepare(shot.sequence, shot.plan, axis, light, known, lit, cells, options.blur)
    jump = axis.stripes.width if axis.stripes else 2.0 * (1 if code is None else float(code.cell))
    stripe = jump if axis.stripes or code is not None else math.inf
    limits = limits_of(axis.extent, 0.5, table.freedom, light.white)
    return AxisDecoder(axis, light, table.noise or noise, code, None, table, None, limits, jump, stripe)


def _freedom(axis: AxisPlan, code: CodePlan | None) -> int:
    """Degrees of freedom of chi2: samples of fringes beyond three each, places that they tell beyond one, and
    what a code adds."""
    freedom = sum(len(fringe.index) - 3 for fringe in axis.fringes) + max(len(axis.fringes) - 1, 0)
    return freedom + ((1 if axis.fringes else 0) + code.freedom if code is not None else 0)


def _by_fringes(found: AxisDecoder, shot: Shot, before: Before) -> AxisDecoder:
    """With fringes, and what they contradict each other by."""
    axis, noise, lit = found.axis, found.noise, shot.lit
    covered = found.code is not None or axis.fringes[0].period >= axis.extent or len(axis.fringes) == 1
    deviation = None if covered else _deviation(axis, noise, lit)
    rounding = _rounding(axis.axis, shot.sequence) if shot.cells else (0.0,) * len(axis.fringes)
    unlike = [_unlike(fringe, lit, noise, before) for fringe in axis.fringes]
    known = tuple(r + m for r, m in zip(rounding, unlike, strict=True))
    found = _with_periods(found, known, deviation)
    few = whole(lit, [i for fringe in axis.fringes for i in fringe.index], _ASKED)
    for _ in range(_ROUNDS if len(axis.fringes) > 1 else 0):
        more = _between(found, few)
        if more == 0:
            break
        found = replace(found, between=found.between + more)
        found = _with_periods(found, tuple(one + found.between for one in known), deviation)
    return found


def _with_periods(decoder: AxisDecoder, known: tuple[float, ...], deviation: float | None) -> AxisDecoder:
    """With fringes whose phases have a variance (turns^2) beside that by noise; deviation: of a sample over
    the amplitude, of close periods."""
    orders = None if deviation is None else _orders(decoder.axis, deviation, max(known))
    return replace(decoder, orders=orders, periods=periods_of(decoder.axis.fringes, known))


def _between(decoder: AxisDecoder, few: Sample) -> float:
    """What periods contradict each other by at the places that a decoder tells of some pixels, beyond what it
    knows of."""
    assert decoder.periods is not None
    shape = 1, len(few.places)
    raw = Raw(*(np.zeros(shape, np.float32) for _ in range(2)))
    shared = Shared(np.zeros(shape, np.uint16), *(np.zeros(shape, np.float32) for _ in range(3)))
    replace(decoder, light=_sampled_light(decoder.light, few.places)).decode((0, 1), raw, True, shared)
    told = np.isfinite(raw.coordinate[0]) & (raw.variance[0] < decoder.axis.extent**2)
    if np.count_nonzero(told) < _FEWEST:
        return 0.0
    place = raw.coordinate[0][told].astype(np.float64)
    return misfit_between(
        decoder.axis.fringes, decoder.periods.rounding, place, few.only(told), decoder.noise
    )


@lru_cache(maxsize=16)
def _rounding(name: str, sequence: Sequence) -> tuple[float, ...]:
    """Variance (turns^2) that the rounding of shown grey values makes in each fringe's phase."""
    axis = next(one for one in plan(sequence).axes if one.axis == name)
    tables = sequence.tables()["uv".index(name)]
    return tuple(float(table_rounding(fringe, tables).var()) for fringe in axis.fringes)


def _unlike(fringe: Fringe, lit: Sample, noise: Noise, before: Before) -> float:
    """Variance (turns^2) of a fringe's phase by what its samples leave beyond noise, and by what they still
    hold of earlier ones: its share in radians at most."""
    _, c, s = np.square(fringe.inverse).sum(axis=1)
    held = before.left.get(fringe.index, before.least)
    return (misfit_within(fringe, lit, noise) * float(c + s) / 2 + held**2) / (2 * np.pi) ** 2


def _cells(code: CodePlan, light: Light, noise: Noise, lit: Sample) -> NDArray[np.float64]:
    """Coordinates (K,) of the sampled pixels' cells; NaN where one is doubtful."""
    estimate = Estimate.empty(1, len(lit.places))
    if len(lit.places):
        read_code(_sampled_light(light, lit.places), noise, code, (0, 1), estimate)
    sure = estimate.error[0] < DOUBT
    return np.where(sure, estimate.coordinate[0], np.nan).astype(np.float64)


def _deviation(axis: AxisPlan, noise: Noise, lit: Sample) -> float:
    """Deviation of a sample over the amplitude of the finest fringe that all but a twentieth of the pixels
    have."""
    fringe = axis.fringes[-1]
    levels = lit.levels[list(fringe.index)]
    c, s = fringe.inverse[1:].astype(np.float32) @ levels
    usual = float(np.quantile(np.hypot(c, s), 0.05)) if levels.size else 1.0
    variance = float(noise.variance(float(levels.mean() if levels.size else 0.0)))
    return float(np.sqrt(variance) / max(usual, 1e-6))


def _orders(axis: AxisPlan, deviation: float, unlike: float) -> Orders:
    """The table of orders for the noise of residues, of two phases each; unlike: variance (turns^2) of a
    phase by rounded grey values and what else its samples leave."""
    noise2 = deviation**2 * 4 / len(axis.fringes[-1].index) / (2 * np.pi) ** 2
    return order_table(
        tuple(f.period for f in axis.fringes), axis.extent, float(np.sqrt(noise2 + 2 * unlike))
    )
