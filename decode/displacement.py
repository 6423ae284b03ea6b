"""Displacement: how far the pattern has moved for every camera pixel since the mirror was at rest."""

from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from optolever.errors import InputError
from optolever.files import load_arrays, save_arrays

from .correspondence import Correspondence

__all__ = ["Displacement", "difference"]

Map = NDArray[np.floating[Any]]
_REQUIRED = ("du", "dv", "sigma_u", "sigma_v", "flags")


@dataclass(frozen=True, slots=True, repr=False)
class Displacement:
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

    def __post_init__(self) -> None:
        shape = np.shape(self.du)
        for field in fields(self):
            value = getattr(self, field.name)
            if value is not None and (np.shape(value) != shape or len(shape) != 2):
                raise InputError(
                    f"displacement: {field.name} has shape {np.shape(value)}, must be 2-D like du {shape}"
                )
        if np.asarray(self.flags).dtype.kind not in "ui":
            raise InputError(f"displacement: flags is {np.asarray(self.flags).dtype}, must be integer")

    def __repr__(self) -> str:
        rows, cols = self.flags.shape
        good = self.good
        text = f"Displacement({rows} x {cols} pixels, {good.mean() if good.size else 0:.1%} good"
        if good.any():
            u, v = (np.median(part[good]) for part in (self.du, self.dv))
            text += f", median du {u:+.3g}, dv {v:+.3g} pattern pixels"
        return text + ")"

    @property
    def good(self) -> NDArray[np.bool_]:
        """True where no flag is set."""
        return np.asarray(self.flags == 0)

    def added_to(self, rest: Correspondence) -> Correspondence:
        """Where the deformed mirror looks: rest + displacement; variances add, flags are or-ed.

        The errors of both are taken as independent. Amplitude and offset are the displacement's.
        """
        _require_same_shape("added_to: displacement", self.flags, rest)
        return Correspondence(
            rest.u + self.du,
            rest.v + self.dv,
            np.hypot(rest.sigma_u, self.sigma_u),
            np.hypot(rest.sigma_v, self.sigma_v),
            (rest.flags | self.flags).astype(np.uint16),
            self.amplitude,
            self.offset,
            _probability_or(rest.order_error, self.order_error),
            rest.notices,
        )

    def save(self, path: str | Path) -> None:
        """Write an .npz with the fields' names."""
        save_arrays(path, {field.name: getattr(self, field.name) for field in fields(self)})

    @classmethod
    def load(cls, path: str | Path) -> "Displacement":
        """Read what save() wrote; InputError names the file and the field."""
        arrays = load_arrays(path, _REQUIRED)
        known = {field.name for field in fields(cls)}
        try:
            return cls(**{name: value for name, value in arrays.items() if name in known})
        except InputError as error:
            raise InputError(f"{path}: {error}") from error


def difference(deformed: Correspondence, rest: Correspondence) -> Displacement:
    """Deformed minus rest, in pattern pixels; variances add, flags are or-ed.

    Amplitude and offset stay those of the deformed capture; order_error: that either order is wrong.
    """
    _require_same_shape("difference: deformed", deformed.flags, rest)
    return Displacement(
        deformed.u - rest.u,
        deformed.v - rest.v,
        np.hypot(deformed.sigma_u, rest.sigma_u),
        np.hypot(deformed.sigma_v, rest.sigma_v),
        (deformed.flags | rest.flags).astype(np.uint16),
        deformed.amplitude,
        deformed.offset,
        _probability_or(deformed.order_error, rest.order_error),
    )


def _require_same_shape(name: str, flags: NDArray[np.uint16], rest: Correspondence) -> None:
    if flags.shape != rest.flags.shape:
        raise InputError(f"{name} is {flags.shape}, rest is {rest.flags.shape}, must be equal")


def _probability_or(first: Map | None, second: Map | None) -> Map | None:
    """Probability that one or the other is wrong, independent of each other; None: not known."""
    if first is None or second is None:
        return first if second is None else second
    return np.asarray(first + second - first * second)
