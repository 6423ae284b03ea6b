"""One axis: estimates from a sample of its frames, choice of decoding steps, their chain over rows."""

import math
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from optolever.notices import Notice
from optolever.patterns import Sequence

from .centre import STEEP
from .codes.gray import CodePlan, code_plan, decode_code, read_code
from .codes.harmonics import aliasing_variance
from .codes.lookup import Table, lookup_rows, prepare
from .codes.lookup_tables import Optics, table_of
from .codes.phase import Periods, periods_of
from .codes.unwrap import Orders, climb, order_table, unwrap_close
from .display import table_rounding
from .estimate import Estimate
from .flags import DOUBT, Into, Limits, Shared, limits_of, merge
from .frames import Light
from .plan import AxisPlan, Fringe, Plan, constraints, plan, raster_axes
from .profile.noise import Noise, Sample
from .profile.unlike import Before, Between, misfit_between, misfit_within, stray_light, whole
from .spatial import Raw

__all__ = [
    "AxisDecoder",
    "AxisNumbers",
    "AxisOptions",
    "LookUp",
    "Setup",
    "Shot",
    "axis_decoders",
    "estimate_axes",
]

#: Fewest pixels for a variance (18 %), sample size (a variance of a fifth is significant), rounds of the
#: interfringe variance: fringe orders depend on it.
_FEWEST, _ASKED, _ROUNDS = 64, 450, 6


@dataclass(frozen=True, slots=True)
class Setup:
    """Sequence of one exposure and the camera's noise; cells: whether the display's cells are modelled;
    white: linear level at which samples saturate."""

    sequence: Sequence
    plan: Plan
    noise: Noise
    cells: bool
    white: float


@dataclass(frozen=True, slots=True)
class Shot:
    """Frames of a setup, and a sample of illuminated pixels."""

    setup: Setup
    light: Light
    lit: Sample


class LookUp(NamedTuple):
    """Estimates of a `Table`: search mode, optics, relative error of their spread, variance of the residuals
    (over the squared amplitude), camera noise by the residuals (None: given)."""

    way: int
    optics: Optics
    unsure: float
    misfit2: float
    noise: Noise | None


class AxisNumbers(NamedTuple):
    """Estimates of an axis from a sample of pixels; with the setup they determine its decoder.

    code       code and the levels of its bits
    unresolved  number of the code's finest bits that the camera does not resolve
    misfit     variance (turns^2) of each fringe's phase by residuals beyond noise
    between    variance (turns^2) of a phase by contradictions between periods
    stray      rms of the phase (turns) of all fringes by stray light, which neighbours share
    deviation  of a sample over the amplitude, of close periods; else None
    look_up    estimates of a look-up
    """

    code: CodePlan | None = None
    unresolved: int = 0
    misfit: tuple[float, ...] = ()
    between: float = 0.0
    stray: float = 0.0
    deviation: float | None = None
    look_up: LookUp | None = None


@dataclass(frozen=True, slots=True)
class AxisDecoder:
    """Decodes rows of frames to coordinates of one axis.

    periods   of the fringes, with phase variance by rounded grey values and misfit
    limits    limits of the flags; jump: largest second difference of neighbours, stripe: finest stripe of a
              code, pattern px; per_turn: turns of the finest fringe per px, 0 without one
    """

    axis: AxisPlan
    noise: Noise
    numbers: AxisNumbers
    orders: Orders | None
    table: Table | None
    periods: Periods | None
    limits: Limits
    jump: float
    stripe: float
    per_turn: float = 0.0

    def decode(self, light: Light, rows: tuple[int, int], raw: Raw, first: bool, shared: Shared) -> None:
        """Decode rows start..stop into the axis' coordinate and variance and the shared maps."""
        into = Into(raw.coordinate, raw.variance, self.limits, first, shared)
        code = self.numbers.code
        if self.table is not None:
            merge(self._looked_up(self.table, light, rows, raw), self.noise, rows, into)
        elif self.periods is None:
            assert code is not None
            decode_code(light, self.noise, code, rows, into)
        elif self.orders is not None:
            unwrap_close(light, self.noise, self.periods, self.orders, rows, into)
        else:
            climb(light, self.noise, self.periods, self.axis.extent, code, rows, into)

    def _looked_up(self, table: Table, light: Light, rows: tuple[int, int], raw: Raw) -> Estimate:
        """Look up rows start..stop; a code gives the starting cells."""
        part = slice(*rows)
        estimate = Estimate.empty(rows[1] - rows[0], light.raw.shape[2])
        estimate = estimate._replace(coordinate=raw.coordinate[part], variance=raw.variance[part])
        if self.numbers.code is not None:
            read_code(light, self.noise, self.numbers.code, rows, estimate)
        lookup_rows(light, self.noise, table, rows, estimate)
        return estimate

    @property
    def stray(self) -> float:
        """Error by stray light, rms, pattern px, which neighbours share; 0 without fringes."""
        return self.numbers.stray * self.axis.fringes[-1].period if self.axis.fringes else 0.0

    def notices(self, width: float) -> tuple[Notice, ...]:
        """Notices of unresolved bits and fringes; width: median footprint of a pixel, pattern px."""
        found, count, name = [], self.numbers.unresolved, self.axis.axis
        if count and self.numbers.code is not None:
            numbers = [str(bit) for bit in range(count)]
            bits = "bit 0" if count == 1 else f"bits {', '.join(numbers[:-1])} and {numbers[-1]}"
            found.append(
                Notice(
                    f"the camera does not resolve {bits} of {name}: cells are read over so many pattern px",
                    float(self.numbers.code.cell),
                    float(self.numbers.code.cell) / 2**count,
                    f"show {name} without them, or bring the camera nearer; sigma holds the wider cells",
                )
            )
        if width * self.per_turn > STEEP:
            found.append(
                Notice(
                    f"neighbours are further apart on {name} than the finest fringe can be followed, turns",
                    width * self.per_turn,
                    STEEP,
                    f"a finest period of {math.ceil(2 * width)} px or more, or a camera nearer to it",
                )
            )
        return tuple(found)


class AxisOptions(NamedTuple):
    """subpixel, blur (cells, None: unknown): see decode; known: the noise is given or follows from
    constraints (else a look-up estimates it); before: display lag; stray: light over the amplitude."""

    subpixel: bool = False
    known: bool = False
    blur: float | None = None
    before: Before = Before()
    stray: float = 0.0


def _axes(setup: Setup) -> tuple[AxisPlan, ...]:
    return raster_axes(setup.sequence) or setup.plan.axes


def estimate_axes(shot: Shot, options: AxisOptions) -> tuple[AxisNumbers, ...]:
    """Estimates of each axis from the sample. InputError where an axis cannot be decoded."""
    known = options.known or bool(constraints(shot.setup.plan, len(shot.setup.sequence)))
    options = options._replace(known=known, stray=stray_light(shot.setup.plan, shot.lit, shot.setup.noise))
    return tuple(_estimated(axis, shot, options) for axis in _axes(shot.setup))


def axis_decoders(setup: Setup, numbers: tuple[AxisNumbers, ...]) -> tuple[AxisDecoder, ...]:
    """A decoder for each axis."""
    return tuple(_decoder(axis, setup, own) for axis, own in zip(_axes(setup), numbers, strict=True))


def _sampled_light(light: Light, places: NDArray[np.int64]) -> Light:
    """Pixels at places (K, 2) as frames of one row."""
    row, col = places.T
    return replace(light, raw=np.ascontiguousarray(light.raw[:, row, col][:, None, :]))


def _estimated(axis: AxisPlan, shot: Shot, options: AxisOptions) -> AxisNumbers:
    setup, lit = shot.setup, shot.lit
    by_table = axis.looked_up or (options.subpixel and axis.code is not None and not axis.fringes)
    code, unresolved = None, 0
    if axis.code is not None:
        fringe = axis.fringes[0] if axis.fringes else None
        code, unresolved = code_plan(axis.code, setup.plan, setup.noise, lit, by_table, fringe)
    if by_table:
        return AxisNumbers(code, look_up=_looked_up(axis, code, shot, options))
    found = AxisNumbers(code, unresolved)
    return _of_fringes(axis, found, shot, options) if axis.fringes else found


def _looked_up(axis: AxisPlan, code: CodePlan | None, shot: Shot, options: AxisOptions) -> LookUp:
    """Estimates of a look-up of known levels."""
    setup, light, lit = shot.setup, shot.light, shot.lit
    cells = None if code is None else _cells(code, light, setup.noise, lit)
    known = setup.noise if options.known else None
    table = prepare(setup.sequence, setup.plan, axis, light, known, lit, cells, options.blur)
    return LookUp(table.way, table.optics, table.unsure, table.misfit2, table.noise)


def _decoder(axis: AxisPlan, setup: Setup, numbers: AxisNumbers) -> AxisDecoder:
    code, per_turn = numbers.code, 0.0
    if numbers.look_up is not None:
        return _by_table(axis, setup, numbers, numbers.look_up)
    if axis.fringes:
        fine = axis.fringes[-1]
        jump, stripe, per_turn, factor = fine.period / 4, math.inf, 1 / fine.period, 2 / len(fine.index)
    else:
        assert code is not None
        jump = stripe = 2.0 * float(code.cell)
        factor = 0.5
    limits = limits_of(axis.extent, factor, _freedom(axis, code), setup.white)
    found = AxisDecoder(axis, setup.noise, numbers, None, None, None, limits, jump, stripe, per_turn)
    return _with_periods(found, setup) if axis.fringes else found


def _by_table(axis: AxisPlan, setup: Setup, numbers: AxisNumbers, look_up: LookUp) -> AxisDecoder:
    """Decoder of an axis of known levels."""
    table = table_of(setup.sequence, setup.plan, axis, look_up.way, look_up.optics)
    table = replace(table, unsure=look_up.unsure, misfit2=look_up.misfit2, noise=look_up.noise)
    code = numbers.code
    jump = axis.stripes.width if axis.stripes else 2.0 * (1 if code is None else float(code.cell))
    stripe = jump if axis.stripes or code is not None else math.inf
    limits = limits_of(axis.extent, 0.5, table.freedom, setup.white)
    noise = look_up.noise or setup.noise
    return AxisDecoder(axis, noise, numbers, None, table, None, limits, jump, stripe)


def _freedom(axis: AxisPlan, code: CodePlan | None) -> int:
    """Degrees of freedom of chi2: samples of each fringe beyond three, fringes beyond the first, those of the
    code."""
    freedom = sum(len(fringe.index) - 3 for fringe in axis.fringes) + max(len(axis.fringes) - 1, 0)
    return freedom + ((1 if axis.fringes else 0) + code.freedom if code is not None else 0)


def _of_fringes(axis: AxisPlan, found: AxisNumbers, shot: Shot, options: AxisOptions) -> AxisNumbers:
    """Add misfit variance of each fringe, the interfringe variance, and stray light."""
    noise, lit = shot.setup.noise, shot.lit
    covered = found.code is not None or axis.fringes[0].period >= axis.extent or len(axis.fringes) == 1
    setup = shot.setup
    hidden = [aliasing_variance(one, axis, setup.plan, lit, noise) / (2 * np.pi) ** 2 for one in axis.fringes]
    misfit = tuple(
        _unlike(one, lit, noise, options.before) + more
        for one, more in zip(axis.fringes, hidden, strict=True)
    )
    found = found._replace(misfit=misfit, deviation=None if covered else _deviation(axis, noise, lit))
    few = whole(lit, [i for fringe in axis.fringes for i in fringe.index], _ASKED)
    stray2 = (options.stray / (2 * np.pi)) ** 2
    for _ in range(_ROUNDS if len(axis.fringes) > 1 else 0):
        more = _between(_decoder(axis, shot.setup, found), shot.light, few)
        if more.variance == 0:
            break
        found, stray2 = found._replace(between=found.between + more.variance), max(stray2, more.common)
    return found._replace(stray=stray2**0.5)


def _with_periods(decoder: AxisDecoder, setup: Setup) -> AxisDecoder:
    """Add periods with phase variance beyond noise, and the table of orders."""
    axis, numbers = decoder.axis, decoder.numbers
    rounding = _rounding(axis.axis, setup.sequence) if setup.cells else (0.0,) * len(axis.fringes)
    known = tuple(r + m + numbers.between for r, m in zip(rounding, numbers.misfit, strict=True))
    orders = None if numbers.deviation is None else _orders(axis, numbers.deviation, max(known))
    return replace(decoder, orders=orders, periods=periods_of(axis.fringes, known))


def _between(decoder: AxisDecoder, light: Light, few: Sample) -> Between:
    """Interfringe variance at the decoded places of sample pixels, beyond the decoder's variances."""
    assert decoder.periods is not None
    shape = 1, len(few.places)
    raw = Raw(*(np.zeros(shape, np.float32) for _ in range(2)))
    shared = Shared(np.zeros(shape, np.uint16), *(np.zeros(shape, np.float32) for _ in range(3)))
    decoder.decode(_sampled_light(light, few.places), (0, 1), raw, True, shared)
    told = np.isfinite(raw.coordinate[0]) & (raw.variance[0] < decoder.axis.extent**2)
    if np.count_nonzero(told) < _FEWEST:
        return Between()
    place = raw.coordinate[0][told].astype(np.float64)
    return misfit_between(
        decoder.axis.fringes, decoder.periods.rounding, place, few.only(told), decoder.noise
    )


@lru_cache(maxsize=16)
def _rounding(name: str, sequence: Sequence) -> tuple[float, ...]:
    """Variance (turns^2) of each fringe's phase by rounding of the displayed grey values."""
    axis = next(one for one in plan(sequence).axes if one.axis == name)
    tables = sequence.tables()["uv".index(name)]
    return tuple(float(table_rounding(fringe, tables).var()) for fringe in axis.fringes)


def _unlike(fringe: Fringe, lit: Sample, noise: Noise, before: Before) -> float:
    """Variance (turns^2) of a fringe's phase by residuals beyond noise, and by residual lag: a share shifts
    the phase by as many radians at most."""
    _, c, s = np.square(fringe.inverse).sum(axis=1)
    held = before.left.get(fringe.index, before.least)
    return (misfit_within(fringe, lit, noise) * float(c + s) / 2 + held**2) / (2 * np.pi) ** 2


def _cells(code: CodePlan, light: Light, noise: Noise, lit: Sample) -> NDArray[np.float64]:
    """Coordinates (K,) of the sampled pixels' cells; NaN where a bit is doubtful."""
    estimate = Estimate.empty(1, len(lit.places))
    if len(lit.places):
        read_code(_sampled_light(light, lit.places), noise, code, (0, 1), estimate)
    sure = estimate.error[0] < DOUBT
    return np.where(sure, estimate.coordinate[0], np.nan).astype(np.float64)


def _deviation(axis: AxisPlan, noise: Noise, lit: Sample) -> float:
    """Deviation of a sample over the 5 % quantile of the finest fringe's amplitude."""
    fringe = axis.fringes[-1]
    levels = lit.levels[list(fringe.index)]
    c, s = fringe.inverse[1:].astype(np.float32) @ levels
    usual = float(np.quantile(np.hypot(c, s), 0.05)) if levels.size else 1.0
    variance = float(noise.variance(float(levels.mean() if levels.size else 0.0)))
    return float(np.sqrt(variance) / max(usual, 1e-6))


def _orders(axis: AxisPlan, deviation: float, unlike: float) -> Orders:
    """Table of fringe orders for the noise of residues of two phases each; unlike: variance (turns^2) of a
    phase by rounded grey values and misfit."""
    noise2 = deviation**2 * 4 / len(axis.fringes[-1].index) / (2 * np.pi) ** 2
    return order_table(
        tuple(f.period for f in axis.fringes), axis.extent, float(np.sqrt(noise2 + 2 * unlike))
    )
