"""Prepared: the precomputed record of a rig at rest, and its file."""

import typing
from dataclasses import asdict, dataclass, fields, is_dataclass
from pathlib import Path
from typing import Annotated, Any, Self

import numpy as np

from optolever.arrays import Cells, Floats
from optolever.errors import InputError
from optolever.files import load_arrays, save_arrays
from optolever.notices import Notice, notices_from_array, notices_to_array
from optolever.scene import Layer
from optolever.schema import built

from ..fringe.chain import Rig
from ..fringe.picture import CELLS

__all__ = ["Noise", "Prepared"]


@dataclass(frozen=True, slots=True, eq=False)
class Noise:
    """Noise of frames at rest, propagated through the chain.

    sigma (R, C): of z less the picture's motion, mm; curl (2,): mean square circulation around blocks of 8
    and 32 cells, mm^2; displacement (2,), turns^2: variance of a cell's displacement, and the
    variance with which independent cells would make a fit of all cells scatter as much as it does."""

    sigma: Annotated[Cells, "R C"]
    curl: Annotated[Floats, "2"]
    displacement: Annotated[Cells, "2"]


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
    points: Annotated[Cells, "3 R C"]
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
        arrays, tree = load_arrays(path, ("rows", "cols", "area", "rig.carriers.share")), dict[str, Any]()
        try:
            for name, value in arrays.items():
                *parents, last = name.split(".")
                branch = tree
                for parent in parents:
                    branch = branch.setdefault(parent, {})
                branch[last] = [*map(asdict, notices_from_array(value))] if name == "notices" else value
            made: Self = built(cls, tree, "")
            carriers = made.rig.carriers
            for name, value in _flat(made, ""):
                if np.ndim(value) and not (np.size(value) and np.isfinite(value).all()):
                    raise InputError(f"{name} is empty or not finite; prepare the rig again")
            if not (made.noise.displacement > 0).all():
                raise InputError("noise.displacement must be above 0; prepare the rig again")
            rows, cols = (carriers.cell * cells for cells in carriers.shape)
            if carriers.cell not in CELLS or carriers.lit.shape != (rows, cols):
                found = f"has {carriers.lit.shape} pixels in cells of {carriers.cell}"
                raise InputError(f"rig.carriers {found}, must be {rows} x {cols} in cells of {CELLS}")
            if not (rows <= made.rows < rows + carriers.cell and cols <= made.cols < cols + carriers.cell):
                raise InputError(
                    f"rows, cols are {made.rows}, {made.cols}, must be {rows}, {cols} or one more"
                )
        except InputError as error:
            raise InputError(f"{path}: {error}") from error
        return made


def _flat(record: Any, prefix: str) -> typing.Iterator[tuple[str, Any]]:
    """Arrays and numbers of nested records by dotted names."""
    for field in fields(record):
        value, name = getattr(record, field.name), prefix + field.name
        if is_dataclass(value):
            yield from _flat(value, f"{name}.")
        elif field.name != "notices" and value is not None:
            yield name, value
