"""One axis: which steps its frames ask for, and their chain over a block of rows."""

from dataclasses import dataclass
from threading import local
from typing import Any

import numpy as np

from optolever.errors import InputError
from optolever.patterns import Sequence

from .candidates import Orders, order_table, unwrap_close
from .display import table_rounding
from .estimate import Estimate
from .flags import Limits, limits_of
from .frames import Light
from .gray import CodePlan, code_plan, read_code
from .micro import MicroTable, micro_table, unwrap_micro
from .noise import Noise, Sample
from .phase import Fit, fit_fringe
from .plan import AxisPlan, Plan
from .spatial import Raw
from .unwrap import join_code, refine_order, start_order

__all__ = ["AxisDecoder", "axis_decoder"]


@dataclass(frozen=True, slots=True)
class AxisDecoder:
    """What turns rows of frames into an Estimate of one axis.

    rounding  mean and variance (turns, turns^2) of each fringe's phase error by the rounding of shown grey values
    limits    beyond which pixels are flagged; jump: largest second difference of neighbours, pattern px
    """

    axis: AxisPlan
    light: Light
    noise: Noise
    code: CodePlan | None
    orders: Orders | None
    micro: MicroTable | None
    rounding: tuple[tuple[float, float], ...]
    limits: Limits
    freedom: int
    jump: float

    def estimate(self, rows: tuple[int, int], raw: Raw, room: local) -> Estimate:
        """Decode rows start..stop; coordinates and variances into the whole maps."""
        count, width = rows[1] - rows[0], self.light.raw.shape[2]
        work = _room(room, count, width)
        part = slice(*rows)
        estimate = Estimate(
            *(raw.coordinate[part], raw.variance[part], *(array[:count] for array in work.shared)),
            self.freedom,
        )
        if self.code is not None and not self.axis.fringes:
            read_code(self.light, self.noise, self.code, rows, True, estimate)
        elif self.micro is not None:
            fit = work.fit(0, count, estimate)
            self._fit(0, rows, fit)
            unwrap_micro(self.light, self.noise, fit, self.axis.fringes[0], self.micro, rows, estimate)
        elif self.orders is not None:
            self._close(rows, work, estimate)
        else:
            self._ladder(rows, work, estimate)
        return estimate

    def _fit(self, i: int, rows: tuple[int, int], fit: Fit) -> None:
        fit_fringe(self.light, self.noise, self.axis.fringes[i], rows, self.rounding[i], fit)

    def _ladder(self, rows: tuple[int, int], work: "_Work", estimate: Estimate) -> None:
        """From the code or the coarsest period to the finest."""
        count = rows[1] - rows[0]
        fit = work.fit(0, count, estimate)
        for i, fringe in enumerate(self.axis.fringes):
            self._fit(i, rows, fit)
            if i > 0:
                refine_order(fit, fringe.period, estimate)
            elif self.code is None:
                start_order(fit, fringe.period, self.axis.extent, estimate)
            else:
                code = work.code(count, self.code.freedom)
                read_code(self.light, self.noise, self.code, rows, False, code)
                join_code(fit, fringe.period, code, self.code.cell, estimate)

    def _close(self, rows: tuple[int, int], work: "_Work", estimate: Estimate) -> None:
        """All periods at once, by a table of orders."""
        assert self.orders is not None
        count, periods = rows[1] - rows[0], tuple(fringe.period for fringe in self.axis.fringes)
        fits = [work.fit(i, count, estimate) for i in range(len(periods))]
        for i, fit in enumerate(fits):
            self._fit(i, rows, fit)
        unwrap_close(fits, periods, self.orders, estimate)


@dataclass(slots=True)
class _Work:
    """Arrays of a block that a thread uses again and again."""

    shared: tuple[Any, ...]
    fits: list[tuple[Any, ...]]
    codes: Estimate | None

    def fit(self, i: int, count: int, estimate: Estimate) -> Fit:
        """Room for the i-th fit; all of them leave amplitude and offset in the estimate, the finest last."""
        while len(self.fits) <= i:
            self.fits.append(tuple(np.empty_like(self.shared[0]) for _ in range(4)))
        turn, variance, chi2, clipped = (array[:count] for array in self.fits[i])
        return Fit(turn, variance, estimate.amplitude, estimate.offset, chi2, clipped)

    def code(self, count: int, freedom: int) -> Estimate:
        """Room for what a code tells."""
        if self.codes is None:
            self.codes = Estimate.empty(*self.shared[0].shape, 0)
        return Estimate(*(array[:count] for array in self.codes.arrays()), freedom)


def _room(room: local, rows: int, cols: int) -> _Work:
    work: _Work | None = getattr(room, "work", None)
    if work is None or len(work.shared[0]) < rows:
        work = room.work = _Work(tuple(np.empty((rows, cols), np.float32) for _ in range(5)), [], None)
    return work


def axis_decoder(
    axis: AxisPlan,
    sequence: Sequence,
    plan: Plan,
    light: Light,
    noise: Noise,
    lit: Sample,
    on_cells: bool,
) -> AxisDecoder:
    """Choose the steps for an axis. InputError where its frames tell no place."""
    if axis.looked_up:
        raise InputError("decode: not yet")
    deviation = _deviation(axis, noise, lit) if axis.fringes else 0.0
    code = None if axis.code is None else code_plan(axis.code, plan)
    micro = micro_table(axis, deviation) if axis.singles else None
    covered = code is not None or axis.fringes[0].period >= axis.extent or len(axis.fringes) == 1
    orders = None if covered else _orders(axis, deviation)
    tables = sequence.tables()["uv".index(axis.axis)]
    shown = on_cells and not sequence.nominal
    rounding = tuple(table_rounding(fringe, tables) if shown else (0.0, 0.0) for fringe in axis.fringes)
    freedom = sum(len(fringe.index) - 3 for fringe in axis.fringes) + max(len(axis.fringes) - 1, 0)
    freedom += sum(len(fringe.index) for fringe in axis.singles)
    freedom += (1 if axis.fringes else 0) + code.freedom if code is not None else 0
    if axis.fringes:
        fine = axis.fringes[-1]
        jump, factor = fine.period / 4, 2 / len(fine.index)
    else:
        assert code is not None
        jump, factor = 2 * code.cell, 0.5
    limits = limits_of(axis.extent, factor, freedom, light.white)
    return AxisDecoder(axis, light, noise, code, orders, micro, rounding, limits, freedom, jump)


def _deviation(axis: AxisPlan, noise: Noise, lit: Sample) -> float:
    """Deviation of a sample over the amplitude of the finest fringe that all but a twentieth of the pixels have."""
    fringe = axis.fringes[-1]
    levels = lit.levels[list(fringe.index)]
    c, s = np.linalg.pinv(fringe.design())[1:].astype(np.float32) @ levels
    usual = float(np.quantile(np.hypot(c, s), 0.05)) if levels.size else 1.0
    variance = float(noise.variance(float(levels.mean() if levels.size else 0.0)))
    return float(np.sqrt(variance) / max(usual, 1e-6))


def _orders(axis: AxisPlan, deviation: float) -> Orders:
    """The table of orders for the noise of residues, of two phases each."""
    turns = deviation * np.sqrt(4 / len(axis.fringes[-1].index)) / (2 * np.pi)
    return order_table(tuple(f.period for f in axis.fringes), axis.extent, float(turns))
