"""Correspondence: where on the pattern every camera pixel looks, how sure that is, and what is wrong."""

from dataclasses import MISSING, dataclass, fields
from enum import IntFlag
from pathlib import Path
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from optolever.errors import InputError
from optolever.files import load_arrays, save_arrays
from optolever.notices import Notice, notices_from_array, notices_to_array
from optolever.records import Axes, Comparable, flag_line, plot_maps, span

__all__ = ["Correspondence", "Flag", "PixelMaps"]

Map = NDArray[np.floating[Any]]


class Flag(IntFlag):
    """Why a pixel is not to be trusted; 0 = good."""

    DARK = 1
    SATURATED = 2
    LOW_CONTRAST = 4
    ORDER_DOUBTFUL = 8
    OFF_PATTERN = 16
    OUTLIER = 32
    MOVED = 64
    INVALID = 128
    WRONG_FRAME = 256


class PixelMaps(Comparable):
    """What records of maps (H, W) of camera pixels share: checks and .npz; `notices` alone is no map."""

    __slots__ = ()
    __dataclass_fields__: ClassVar[dict[str, Any]]
    flags: NDArray[np.uint16]

    def __post_init__(self) -> None:
        record, first = type(self).__name__.lower(), fields(self)[0].name
        shape = np.shape(getattr(self, first))
        for field in fields(self):
            value = getattr(self, field.name)
            if field.name == "notices" or value is None:
                continue
            if np.shape(value) != shape or len(shape) != 2:
                found = f"{field.name} has shape {np.shape(value)}"
                raise InputError(f"{record}: {found}, must be 2-D like {first} {shape}")
        if np.asarray(self.flags).dtype.kind not in "ui":
            raise InputError(f"{record}: flags is {np.asarray(self.flags).dtype}, must be integer")

    @property
    def good(self) -> NDArray[np.bool_]:
        """True where no flag is set."""
        return np.asarray(self.flags == 0)

    def save(self, path: str | Path) -> None:
        """Write an .npz with the fields' names."""
        arrays = {field.name: getattr(self, field.name) for field in fields(self)}
        if "notices" in arrays:
            arrays["notices"] = notices_to_array(arrays["notices"]) if arrays["notices"] else None
        save_arrays(path, arrays)

    @classmethod
    def load(cls, path: str | Path) -> Self:
        """Read what save() wrote; InputError names the file and the field."""
        required = tuple(field.name for field in fields(cls) if field.default is MISSING)
        arrays: dict[str, Any] = load_arrays(path, required)
        known = {field.name for field in fields(cls)} & set(arrays)
        try:
            if "notices" in known:
                arrays["notices"] = notices_from_array(arrays["notices"])
            return cls(**{name: arrays[name] for name in known})
        except InputError as error:
            raise InputError(f"{path}: {error}") from error


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Correspondence(PixelMaps):
    """Per camera pixel, all (H, W).

    u, v               what the centre of the camera's pixel sees, pattern pixels, integer = pixel centre
                       (what is read is the mean over its area, see centre); NaN along an axis that was not
                       encoded
    sigma_u, sigma_v   standard deviations, pattern pixels; inf along an axis that was not encoded
    flags              uint16 bit field of Flag, 0 = good
    amplitude, offset  of the modulation, camera levels (the smaller amplitude of both axes, the mean level)
    order_error        probability that a fringe order or code bit is wrong
    notices            what the whole capture wants its user to know
    """

    u: Map
    v: Map
    sigma_u: Map
    sigma_v: Map
    flags: NDArray[np.uint16]
    amplitude: Map | None = None
    offset: Map | None = None
    order_error: Map | None = None
    notices: tuple[Notice, ...] = ()

    def __repr__(self) -> str:
        good = self.good
        rows, cols = good.shape
        lines = [f"Correspondence: {rows} x {cols} pixels, {100 * good.mean():.4g} % good"]
        for axis, values, sigma in (("u", self.u, self.sigma_u), ("v", self.v, self.sigma_v)):
            lines.append(f"  {axis} {span(values, good)}, sigma {span(sigma, good)} pattern pixels")
        lines.append("  " + flag_line(self.flags, {flag.value: str(flag.name) for flag in Flag}))
        return "\n".join([*lines, *([f"  notices: {len(self.notices)}"] if self.notices else [])])

    def plot(self, axes: Any = None) -> Axes:
        """Draw u and v of the good pixels, and their sigma, with matplotlib; the axes, one per map."""
        sigma = np.hypot(self.sigma_u, self.sigma_v)
        maps = {"u [pattern px]": self.u, "v [pattern px]": self.v, "sigma of both [pattern px]": sigma}
        return plot_maps({title: np.where(self.good, one, np.nan) for title, one in maps.items()}, axes)
