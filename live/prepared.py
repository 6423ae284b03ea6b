"""Prepared: the precomputed record of a rig at rest, and its file."""

import typing
from dataclasses import dataclass, fields, is_dataclass
from pathlib import Path
from typing import Any, Self

import numpy as np

from optolever.errors import InputError
from optolever.files import load_arrays, save_arrays
from optolever.notices import Notice, notices_from_array, notices_to_array
from optolever.scene import Layer

from .arrays import Cells, Float
from .chain import Rig

__all__ = ["Noise", "Prepared"]


@dataclass(frozen=True, slots=True, eq=False)
class Noise:
    """Noise of frames at rest, propagated through the chain.

    sigma (R, C): of z less the picture's motion, mm; curl (2,): mean square circulation around blocks of 8
    and 32 cells, mm^2; draws (K, R, C): such heights of single frames; their scatter in any figure is the
    figure's sigma; displacement (2,), turns^2: variance of a cell's displacement, and the variance with which
    independent cells would make a fit of all cells scatter as much as it does."""

    sigma: Cells
    curl: Float
    draws: Cells
    displacement: Cells


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Prepared:
    """A rig at rest, as `Live` needs it. rows, cols: of the camera's frames; incomplete cells at their end
    are unused; points (3, R, C): of the mirror at rest, mm; area: of a cell on the mirror, mm^2; edge:
    standard deviation of the height at which the mirror's edge stays, mm; error: of heights by the rig's
    numbers, relative (None: of a file without it); layer: elastic, or None; notices: of the preparation."""

    rig: Rig
    noise: Noise
    rows: int
    cols: int
    points: Cells
    area: float
    edge: float
    error: float | None = None
    layer: Layer | None = None
    notices: tuple[Notice, ...] = ()

    def __repr__(self) -> str:
        carriers, sigma = self.rig.carriers, float(np.median(self.noise.sigma[self.rig.lit]))
        rows, cols = carriers.shape
        return (
            f"Prepared: frames of {self.rows} x {self.cols} pixels, "
            f"{rows} x {cols} cells of {carriers.cell} pixels\n"
            f"  crossed fringe of {carriers.period:g} pattern pixels, "
            f"noise {self.rig.noise**0.5:.3g} levels, "
            f"sigma of z {1e6 * sigma:.3g} nm"
        )

    def save(self, path: str | Path) -> None:
        """Write an .npz."""
        arrays = dict(_flat(self, ""))
        save_arrays(path, arrays | {"notices": notices_to_array(self.notices) if self.notices else None})

    @classmethod
    def load(cls, path: str | Path) -> Self:
        """Read what save() wrote; InputError names the file and the field."""
        arrays = load_arrays(path, ("rows", "cols", "area", "rig.carriers.share"))
        kept = notices_from_array(arrays.pop("notices")) if "notices" in arrays else ()
        try:
            made: Self = _built(cls, arrays, "", {"notices": kept})
        except KeyError as error:
            raise InputError(f"{path}: field {error.args[0]!r} is missing") from error
        except (TypeError, ValueError) as error:
            raise InputError(f"{path}: not what `live` saved ({error})") from error
        shape = made.rig.carriers.shape
        for name in ("rig.rest.planes", "noise.sigma", "points", "rig.mirror.planes"):
            if arrays[name].shape[-2:] != shape:
                raise InputError(f"{path}: {name} is {arrays[name].shape}, must be of {shape} cells")
        return made


def _flat(record: Any, prefix: str) -> typing.Iterator[tuple[str, Any]]:
    """Arrays and numbers of nested records by dotted names."""
    for field in fields(record):
        value, name = getattr(record, field.name), prefix + field.name
        if is_dataclass(value):
            yield from _flat(value, f"{name}.")
        elif field.name != "notices" and value is not None:
            yield name, value


def _built(kind: Any, arrays: dict[str, Any], prefix: str, given: dict[str, Any] | None = None) -> Any:
    """Inverse of _flat. KeyError of a name that is not there."""
    values = dict(given or {})
    for name, hint in typing.get_type_hints(kind).items():
        whole, options = prefix + name, typing.get_args(hint) or (hint,)
        if name in values:
            continue
        if type(None) in options and not any(f"{key}.".startswith(f"{whole}.") for key in arrays):
            values[name] = None
        elif is_dataclass(options[0]):
            values[name] = _built(options[0], arrays, f"{whole}.")
        else:
            value = arrays[whole]
            values[name] = options[0](value[()]) if options[0] in (int, float, bool) else value
    return kind(**values)
