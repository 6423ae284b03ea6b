"""Correspondence: pattern coordinates of every camera pixel, their sigma, and flags."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, fields
from enum import IntFlag
from pathlib import Path
from typing import Annotated, Any, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from optolever.errors import InputError
from optolever.files import save_arrays
from optolever.notices import Judged, Notice, notices_to_array
from optolever.records import Axes, Comparable, flag_line, plot_maps, span
from optolever.schema import load_record, require_shapes

__all__ = ["Correspondence", "Flag", "SharedNoise"]

Map = Annotated[NDArray[np.floating[Any]], "H W"]


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
    cosine of its phase. lens: standard deviation of half the second moment
    of a camera pixel's aperture, px^2 of the camera, by a lens that was not given: places of u and of v are
    off by it times laplace u + 2 grad u . grad ln A.
    """

    rows: float
    cols: float
    frames_u: float
    frames_v: float
    turns_u: float
    turns_v: float
    lens_u: float = 0.0
    lens_v: float = 0.0


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Correspondence(Comparable):
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
    common_u           standard deviation of an error that all u have in common, pattern pixels: stripes of a
                       display in colour are unknown
    tests              agreement of the frames with their description: figures, limits
    """

    u: Map
    v: Map
    sigma_u: Map
    sigma_v: Map
    flags: Annotated[NDArray[np.uint16], "H W"]
    amplitude: Map | None = None
    offset: Map | None = None
    order_error: Map | None = None
    notices: tuple[Notice, ...] = ()
    shared_noise: SharedNoise | None = None
    tests: tuple[Judged, ...] = ()
    common_u: float = 0.0

    def __post_init__(self) -> None:
        require_shapes(self)
        if np.asarray(self.flags).dtype.kind not in "ui":
            raise InputError(f"correspondence: flags is {np.asarray(self.flags).dtype}, must be integer")

    @property
    def good(self) -> NDArray[np.bool_]:
        """True where no flag is set."""
        return np.asarray(self.flags == 0)

    def save(self, path: str | Path) -> None:
        """Write an .npz with the fields' names."""
        arrays: dict[str, Any] = {field.name: getattr(self, field.name) for field in fields(self)}
        arrays["tests"] = np.array([json.dumps(asdict(one)) for one in self.tests]) if self.tests else None
        save_arrays(path, arrays | {"notices": notices_to_array(self.notices) if self.notices else None})

    @classmethod
    def load(cls, path: str | Path) -> Self:
        """Read what save() wrote; InputError names the file and the field."""
        return load_record(cls, path, ("notices", "tests"), shared_noise=_shared_noise)

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


def _shared_noise(stored: NDArray[Any]) -> SharedNoise:
    """Shared noise from its stored array (8,)."""
    limits = np.array([1.0, 1.0, 1.0, 1.0, *4 * [np.inf]])
    if stored.shape != limits.shape or not ((stored >= 0) & (stored <= limits) & np.isfinite(stored)).all():
        raise InputError(f"shared_noise is {stored.tolist()}, must be four shares (0 to 1), turns, lenses")
    return SharedNoise(*map(float, stored))
