"""Plans as plain arrays, the form in which the compiled kernels take them."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from optolever.errors import InputError
from optolever.patterns import Sequence

from .plan import Fringe, plan

__all__ = ["FringeArrays", "axis_arrays", "chi_squared_limit", "fringe_arrays"]

F32 = NDArray[np.float32]
#: Model (A, c, s) of shifts of 0, 1, 2 and 3 quarters of a period.
_QUARTERS = np.array([[1, 1, 0], [1, 0, 1], [1, -1, 0], [1, 0, -1]])


@dataclass(frozen=True, slots=True)
class FringeArrays:
    """count, even, quarters, periods, misfit (G,), index (G, M), solve (G, 4, M), model (G, M, 4),
    quad (G, 4, 3).

    M is the largest count, rounded up to a multiple of 4; what is beyond a period's own count has weight 0.
    solve = rows for A, c, s and, of four samples, for the one contrast that these three do not reach.
    model = (1, design), so that a residual is model[0] I - model[1:] . (A, c, s).

    quad holds, for the parameters' variance, sum_i w_i (S1 S1, S1 S2, S2 S2)_i with S = solve and the weights
    w = 1 (read noise), e (offset), e cos d, e sin d (shot noise of the offset and of the fringe itself);
    even: these are diag(r, r), diag(a, a), 0, 0, so that the variance is the same at all phases;
    quarters: index has four samples at shifts of 0, 1, 2 and 3 quarters, of the same exposure 1;
    misfit is the limit of the squared residuals over their variance.
    """

    count: NDArray[np.int64]
    index: NDArray[np.int64]
    solve: F32
    model: F32
    quad: F32
    even: NDArray[np.bool_]
    quarters: NDArray[np.bool_]
    periods: F32
    misfit: NDArray[np.float64]


@lru_cache(maxsize=16)
def axis_arrays(sequence: Sequence, axis: str) -> FringeArrays:
    """fringe_arrays of one axis of a sequence, kept: a series of captures asks for them again and again."""
    return fringe_arrays(next(part for part in plan(sequence).axes if part.axis == axis).fringes, axis)


def fringe_arrays(fringes: tuple[Fringe, ...], axis: str) -> FringeArrays:
    """Padded to the longest period's number of frames. InputError if shifts do not determine a phase."""
    groups, most = len(fringes), max([-(-len(fringe.index) // 4) * 4 for fringe in fringes], default=4)
    index = np.zeros((groups, most), np.int64)
    solve = np.zeros((groups, 4, most), np.float32)
    model = np.zeros((groups, most, 4), np.float32)
    quad = np.zeros((groups, 4, 3), np.float32)
    quarters = np.zeros(groups, np.bool_)
    for g, fringe in enumerate(map(_in_order, fringes)):
        n = len(fringe.index)
        design = fringe.design()
        if n < 3 or np.linalg.cond(design) > 1e3:
            raise InputError(
                f"sequence: fringe of period {fringe.period:g} px on {axis} has {n} frames with shifts "
                f"{np.round(fringe.shifts, 3).tolist()}, must have 3 distinct ones"
            )
        inverse = fringe.solve()
        index[g, :n], solve[g, :3, :n], model[g, :n, 1:] = fringe.index, inverse, design
        quarters[g] = n == 4 and np.allclose(design, _QUARTERS, atol=1e-6)
        if n == 4:
            solve[g, 3, :n] = fringe.contrasts()[0]
        # frames that only fill up are the first one again, with weight 0
        index[g, n:], model[g, :n, 0] = fringe.index[0], 1
        pairs = np.stack([inverse[1] ** 2, inverse[1] * inverse[2], inverse[2] ** 2], axis=1)
        quad[g] = np.concatenate([np.ones((n, 1)), design], axis=1).T @ pairs
    count = np.array([len(fringe.index) for fringe in fringes], np.int64)
    misfit = np.array([chi_squared_limit(int(n) - 3) for n in count], np.float64)
    periods = np.array([fringe.period for fringe in fringes], np.float32)
    return FringeArrays(count, index, solve, model, quad, _even(quad), quarters, periods, misfit)


def _in_order(fringe: Fringe) -> Fringe:
    """The same fringe, shifts rising within a turn."""
    turns = np.mod(fringe.shifts / (2 * np.pi) + 1e-9, 1.0)
    order = np.argsort(turns, kind="stable")
    index = tuple(fringe.index[i] for i in order)
    return Fringe(index, fringe.period, fringe.shifts[order], fringe.exposure[order])


def _even(quad: F32) -> NDArray[np.bool_]:
    """Whether the variance is the same at all phases (G,)."""
    same = np.stack([quad[:, :2, 0] - quad[:, :2, 2], quad[:, :2, 1]], axis=1).reshape(-1, 4)
    rest = np.concatenate([same, quad[:, 2:].reshape(-1, 6)], axis=1)
    return np.asarray((np.abs(rest) < 1e-6 * quad[:, :1, 0]).all(axis=1))


def chi_squared_limit(freedom: int, sigmas: float = 5.0) -> float:
    """Chi squared that noise exceeds as rarely as a Gaussian `sigmas`, inf without degrees of freedom.

    Wilson & Hilferty (1931), doi:10.1073/pnas.17.12.684.
    """
    if freedom < 1:
        return float("inf")
    part = 2 / (9 * freedom)
    return float(freedom * (1 - part + sigmas * part**0.5) ** 3)
