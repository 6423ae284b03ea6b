"""Displacement: how far the pattern has moved for every camera pixel since the mirror was at rest."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from optolever.errors import InputError

from .correspondence import Correspondence, PixelMaps

__all__ = ["Displacement", "difference"]

Map = NDArray[np.floating[Any]]


@dataclass(frozen=True, slots=True, repr=False, eq=False)
class Displacement(PixelMaps):
    """Deformed minus rest, per camera pixel, all (H, W). Its .npz holds no u and v: no Correspondence.

    du, dv             pattern pixels
    sigma_u, sigma_v   their standard deviations, pattern pixels
    flags              uint16 bit field of Flag, 0 = good
    amplitude, offset  of the modulation in the deformed frames, camera levels
    order_error        probability that a fringe order or code bit is wrong
    """

    du: Map
    dv: Map
    sigma_u: Map
    sigma_v: Map
    flags: NDArray[np.uint16]
    amplitude: Map | None = None
    offset: Map | None = None
    order_error: Map | None = None

    def __repr__(self) -> str:
        rows, cols = self.flags.shape
        good = self.good
        text = f"Displacement({rows} x {cols} pixels, {good.mean() if good.size else 0:.1%} good"
        if good.any():
            u, v = (np.median(part[good]) for part in (self.du, self.dv))
            text += f", median du {u:+.3g}, dv {v:+.3g} pattern pixels"
        return text + ")"

    def added_to(self, rest: Correspondence) -> Correspondence:
        """Where the deformed mirror looks: rest + displacement; variances add, flags are or-ed.

        The errors of both are taken as independent. Amplitude and offset are the displacement's.
        """
        common = _common(self, rest)
        return Correspondence(rest.u + self.du, rest.v + self.dv, **common, notices=rest.notices)


def difference(deformed: Correspondence, rest: Correspondence) -> Displacement:
    """Deformed minus rest, in pattern pixels; variances add, flags are or-ed.

    Amplitude and offset stay those of the deformed capture; order_error: that either order is wrong.
    """
    common = _common(deformed, rest)
    return Displacement(deformed.u - rest.u, deformed.v - rest.v, **common)


def _probability_or(first: Map | None, second: Map | None) -> Map | None:
    """Probability that one or the other is wrong, independent of each other; None: not known."""
    if first is None or second is None:
        return first if second is None else second
    return np.asarray(first + second - first * second)


def _common(now: Correspondence | Displacement, rest: Correspondence) -> dict[str, Any]:
    """Fields of both kinds of record that follow from what is seen now and at rest."""
    if now.flags.shape != rest.flags.shape:
        raise InputError(f"displacement: now is {now.flags.shape}, rest is {rest.flags.shape}, must be equal")
    return {
        "sigma_u": np.hypot(now.sigma_u, rest.sigma_u),
        "sigma_v": np.hypot(now.sigma_v, rest.sigma_v),
        "flags": (now.flags | rest.flags).astype(np.uint16),
        "amplitude": now.amplitude,
        "offset": now.offset,
        "order_error": _probability_or(now.order_error, rest.order_error),
    }
