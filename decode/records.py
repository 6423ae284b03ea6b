"""Correspondence: pattern coordinates of every camera pixel, their sigma, and flags; Displacement: change of
the pattern coordinates since the mirror was at rest."""

from __future__ import annotations

from dataclasses import MISSING, dataclass, fields
from enum import IntFlag
from pathlib import Path
from typing import Any, ClassVar, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from optolever.errors import InputError
from optolever.files import load_arrays, save_arrays
from optolever.notices import Notice, notices_from_array, notices_to_array
from optolever.records import Axes, Comparable, flag_line, plot_maps, span

__all__ = ["Correspondence", "Displacement", "Flag", "PixelMaps", "SharedNoise"]

Map = NDArray[np.floating[Any]]


class Flag(IntFlag):
    """Why a pixel is not to be trusted; 0 = good."""

    DARK = 1
    SATURATED = 2
    LOW_CONTRAST = 4
    ORDER_DOUBTFUL = 8
    OFF_PATTERN = 16
    OUTLIER = 32
    INVALID = 128
    WRONG_FRAME = 256


class SharedNoise(NamedTuple):
    """Shares (0 to 1) of the frames' noise variance that pixels have in common: within a row, within a
    column, and, for the frames of u and of v, over the image by level and phase (a lamp that flickers).
    turns: of the finest fringe along u and v per pattern pixel; a frame's noise shifts the place by the
    cosine of its phase. shift: standard deviation common to all of u and of v, pattern pixels, by motion of
    camera or mirror, by stray light such as a second reflection, and by residual pixelation where the
    sampling is commensurate with the display's cells.
    """

    rows: float
    cols: float
    frames_u: float
    frames_v: float
    turns_u: float
    turns_v: float
    shift_u: float = 0.0
    shift_v: float = 0.0


#: Fields of records that are not maps.
_NO_MAPS = ("notices", "shared_noise")


class PixelMaps(Comparable):
    """Common base of records of maps (H, W) of camera pixels: checks and .npz."""

    __slots__ = ()
    __dataclass_fields__: ClassVar[dict[str, Any]]
    flags: NDArray[np.uint16]

    def __post_init__(self) -> None:
        record, first = type(self).__name__.lower(), fields(self)[0].name
        shape = np.shape(getattr(self, first))
        for field in fields(self):
            value = getattr(self, field.name)
            if field.name in _NO_MAPS or value is None:
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
            if "shared_noise" in known:
                arrays["shared_noise"] = _shared_noise(arrays["shared_noise"])
            return cls(**{name: arrays[name] for name in known})
        except InputError as error:
            raise InputError(f"{path}: {error}") from error


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Correspondence(PixelMaps):
    """Per camera pixel, all (H, W).

    u, v               pattern coordinates at the centre of the camera pixel, pattern pixels, integer = pixel
                       centre (the pixel itself averages over its area, see centre); NaN along an axis that
                       was not encoded
    sigma_u, sigma_v   standard deviations, pattern pixels; inf along an axis that was not encoded
    flags              uint16 bit field of Flag, 0 = good
    amplitude, offset  of the modulation, camera levels (the smaller amplitude of both axes, the mean level)
    order_error        probability that a fringe order or code bit is wrong
    notices            warnings about the whole capture
    shared_noise       noise that pixels have in common; None: unknown
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
    shared_noise: SharedNoise | None = None

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
        """Correspondence of the deformed mirror: rest + displacement; variances add, flags are or-ed.

        The errors of both are taken as independent. Amplitude and offset are the displacement's.
        """
        common = _common(self, rest)
        return Correspondence(
            rest.u + self.du, rest.v + self.dv, **common, notices=rest.notices, shared_noise=rest.shared_noise
        )


def _shared_noise(stored: NDArray[Any]) -> SharedNoise:
    """Shared noise from its stored array (8,)."""
    limits = np.array([1.0, 1.0, 1.0, 1.0, *4 * [np.inf]])
    if stored.shape != (8,) or not ((stored >= 0) & (stored <= limits) & np.isfinite(stored)).all():
        raise InputError(f"shared_noise is {stored.tolist()}, must be four shares (0 to 1), turns and shifts")
    return SharedNoise(*map(float, stored))


def _probability_or(first: Map | None, second: Map | None) -> Map | None:
    """Probability that one or the other is wrong, if independent; None: unknown."""
    if first is None or second is None:
        return first if second is None else second
    return np.asarray(first + second - first * second)


def _common(now: Correspondence | Displacement, rest: Correspondence) -> dict[str, Any]:
    """Fields of both kinds of record, from the deformed and the rest state."""
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
