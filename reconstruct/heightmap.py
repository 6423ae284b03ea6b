"""HeightMap: where the mirror is, how sure that is, and why not where it fails; and its files."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, field, fields, replace
from enum import IntFlag
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from optolever.decode import Flag
from optolever.errors import InputError
from optolever.files import load_arrays, save_arrays
from optolever.notices import Notice, notices_from_array, notices_to_array
from optolever.records import Axes, Comparable, flag_line, plot_maps, span

from .arrays import Floats, Mask
from .outputs.coarse_modes import CoarseModes, coarsened, expanded
from .outputs.export import chosen, write_ply, write_stl, write_tiff, write_xyz
from .outputs.resampling import GRID_FORMATS, Grid, Lean, natural_pitch, resample

__all__ = ["HEIGHT_FORMATS", "Diagnostics", "HeightFlag", "HeightMap"]

#: How a height map is written, by the file's suffix.
HEIGHT_FORMATS = GRID_FORMATS | {".ply": "save_ply", ".stl": "save_stl", ".xyz": "save_xyz"}

_ARRAYS = ("x", "y", "z", "sigma", "flags")


class HeightFlag(IntFlag):
    """Reasons not to trust a height, in addition to the decoder's (bits below 1024); 0 = good.

    NO_ANCHOR: nothing ties the pixel to a known height; CURL: its slopes are those of no surface; STEEP: it
    is reached only across slopes that change too fast between pixels (a cusp, a rim), what that may cost
    exceeds three sigma of the pixels around and is in its sigma (not so where pixels are missing along the
    same line: a step of any height may hide there, and the piece behind it is flagged); NOT_CONVERGED: the
    last steps still moved it, or so many others that nothing can be said of any; SINGULAR: the pattern lies
    within its noise of the mirror or of the ray there, so that there is no normal, or so near that the
    solution does not converge there (a scene that is slightly wrong), or its total sigma is a hundred
    times that of its neighbours; IMPLAUSIBLE: no rig of the scene's accuracy can have
    taken the capture (on all pixels).
    """

    NO_ANCHOR = 1024
    CURL = 2048
    STEEP = 4096
    NOT_CONVERGED = 8192
    SINGULAR = 16384
    IMPLAUSIBLE = 32768


@dataclass(frozen=True, slots=True)
class Diagnostics:
    """How a solve went.

    steps: rms change of the unknown in every step (mm, or relative where the rays diverge); iterations:
    linear solves or conjugate-gradient iterations; defect: rms edge defect over its standard deviation (below
    1: noise alone); curl: robust scale of the slopes' curl over its standard deviation (well above 1: the
    calibration rules, not noise); both None if unknown; components: connected components solved; lost: pixels
    in components without an anchor; chi2: of the slopes' circulation around blocks of pixels, per degree of
    freedom, `freedom` in number (see `circulation`; about 1 if the scene is right, None without a complete
    block); noise: share of the variance by every source (see `uncertainty.sources`), median; solver: of the
    linear problems; notes: what else a reader should know; slope_sigma: median standard deviations of dz/dx
    and dz/dy by noise, where they were computed.
    """

    method: str
    converged: bool = True
    steps: tuple[float, ...] = ()
    iterations: int = 0
    defect: float | None = None
    curl: float | None = None
    components: int = 0
    lost: int = 0
    noise: dict[str, float] = field(default_factory=dict)
    chi2: float | None = None
    freedom: int = 0
    solver: str = ""
    notes: tuple[str, ...] = ()
    slope_sigma: tuple[float, float] | None = None

    def to_json(self) -> str:
        """As one line of JSON."""
        return json.dumps(asdict(self))

    @classmethod
    def from_json(cls, text: str) -> Diagnostics:
        """The inverse of to_json; unknown entries are skipped."""
        known = {entry.name for entry in fields(cls)}
        values = {name: value for name, value in json.loads(text).items() if name in known}
        for name in ("steps", "notes"):
            values[name] = tuple(values.get(name, ()))
        if values.get("slope_sigma") is not None:
            values["slope_sigma"] = tuple(values["slope_sigma"])
        return cls(**values)


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class HeightMap(Comparable):
    """Mirror points on the camera's pixels, (H, W) each, mm in the mirror's frame.

    x, y, z: NaN where nothing is known; sigma: standard deviation of z at that pixel, whose point then moves
    along the pixel's ray; flags: uint16, 0 = good: the decoder's bits and those of HeightFlag;
    lean: dx/dz and dy/dz along the rays, (2, H, W), or (2, 1, 1) if all are parallel, None if unknown (taken
    as upright); notices: warnings about the map, the correspondence's included;
    calibration: (r, H, W) mm, change of z by one standard deviation of every independent error of the rig,
    apart from `sigma`; an error is common to all heights. None: the scene is exact.
    sources, shares (s, r, r): origins of these errors, in words, and each one's part of their covariance
    (see `budget`); none: not known.
    displacement: (m, 2, 3), m >= r: the change of x and y by one standard deviation of every independent
    error of the rig, an affine field displacement[k] @ (1, x, y) in mm. The first r errors are those of
    `calibration`; the others move the map along the mirror and change no height (the gauge). None: x and y
    are exact.
    own: number of the last modes, errors of this capture alone (motion of the rig since the rest
    capture): they do not cancel in a difference of two maps.
    references: names (k,) of the rest capture and the anchors that the map rests on; shared (k, H, W) mm: the
    part of `sigma` that is theirs, common to all maps of the same reference.
    """

    x: Floats
    y: Floats
    z: Floats
    sigma: Floats
    flags: NDArray[np.uint16]
    diagnostics: Diagnostics = field(default_factory=lambda: Diagnostics("unknown"))
    lean: Lean | None = None
    notices: tuple[Notice, ...] = ()
    calibration: NDArray[np.float32] | None = None
    sources: tuple[str, ...] = ()
    shares: Floats | None = None
    displacement: Floats | None = None
    own: int = 0
    references: tuple[str, ...] = ()
    shared: Floats | None = None

    def __post_init__(self) -> None:
        shape = np.shape(self.z)
        for name in _ARRAYS:
            if np.shape(getattr(self, name)) != shape or len(shape) != 2:
                found = np.shape(getattr(self, name))
                raise InputError(f"height map: {name} has shape {found}, must be 2-D like z {shape}")
        if self.lean is not None and self.lean.shape not in ((2, *shape), (2, 1, 1)):
            raise InputError(
                f"height map: lean has shape {self.lean.shape}, must be {(2, *shape)} or (2, 1, 1)"
            )

        if self.calibration is not None and (
            self.calibration.ndim != 3 or self.calibration.shape[1:] != shape
        ):
            raise InputError(
                f"height map: calibration has shape {self.calibration.shape}, must be (r, *{shape})"
            )
        modes = 0 if self.calibration is None else len(self.calibration)
        if modes and self.shares is not None and self.shares.shape != (len(self.sources), modes, modes):
            found = f"{len(self.sources)} sources, {modes} modes"
            raise InputError(f"height map: shares has shape {self.shares.shape}, of {found}")
        parts = None if self.shared is None else self.shared.shape
        if self.references and parts != (len(self.references), *shape):
            raise InputError(
                f"height map: shared has shape {parts}, must be {(len(self.references), *shape)}"
            )
        if self.displacement is not None and (
            self.displacement.shape[1:] != (2, 3) or len(self.displacement) < modes
        ):
            raise InputError(
                f"height map: displacement has shape {self.displacement.shape}, must be (m, 2, 3), "
                f"m at least {modes}"
            )

    def __repr__(self) -> str:
        good = self.good
        rows, cols = good.shape
        names = {flag.value: str(flag.name) for flag in (*Flag, *HeightFlag)}
        lines = [f"HeightMap: {rows} x {cols} pixels, {100 * good.mean():.4g} % good"]
        lines.append(f"  z {span(self.z, good)} mm, sigma {span(self.sigma, good)} mm")
        lines.append(f"  x {span(self.x, good)}, y {span(self.y, good)} mm")
        lines.append("  " + flag_line(self.flags, names))
        modes = 0 if self.calibration is None else len(self.calibration)
        return "\n".join(
            [*lines, f"  method {self.diagnostics.method}, {modes} modes, {len(self.notices)} notices"]
        )

    def plot(self, axes: Any = None) -> Axes:
        """Draw z and its standard deviation (noise and rig) of the good pixels with matplotlib; the axes."""
        maps = {"z [mm]": self.z, "sigma [mm]": self.total_sigma}
        return plot_maps({title: np.where(self.good, one, np.nan) for title, one in maps.items()}, axes)

    def __sub__(self, other: HeightMap) -> HeightMap:
        """This map less another one of the same rig, pixel by pixel: sigma is of the difference, modes
        cancel as far as they are common, flags of both are joined. x, y and lean are this map's.
        """
        if not isinstance(other, HeightMap):
            return NotImplemented
        z, _ = self.difference(other)
        return replace(
            self,
            z=z,
            sigma=self._noise_less(other),
            flags=self.flags | other.flags,
            diagnostics=Diagnostics("difference"),
            notices=tuple(dict.fromkeys((*self.notices, *other.notices))),
            references=(),
            shared=None,
            **self._modes_less(other),
        )

    def _noise_less(self, other: HeightMap) -> Floats:
        """Standard deviation of the difference by noise and anchors; errors of common references cancel as
        far as they are equal in both maps."""
        variance = np.square(self.sigma) + np.square(other.sigma)
        if self.shared is not None and other.shared is not None:
            for name in set(self.references) & set(other.references):
                one, two = self.references.index(name), other.references.index(name)
                variance = variance - 2 * np.nan_to_num(self.shared[one] * other.shared[two])
        noise: Floats = np.sqrt(np.maximum(variance, np.square(self.sigma - other.sigma)))
        return noise

    def _modes_less(self, other: HeightMap) -> dict[str, Any]:
        """The modes of the difference: common ones less the other's, then those of either capture alone."""
        if self.calibration is None or other.calibration is None:
            return {"calibration": None, "sources": (), "shares": None, "displacement": None, "own": 0}
        common, own = len(self.calibration) - self.own, self.own + other.own
        modes = [self.calibration[:common] - other.calibration[:common]]
        modes += [self.calibration[common:], other.calibration[common:]]
        changed: dict[str, Any] = {"calibration": np.concatenate(modes), "own": own}
        if self.shares is not None:
            wider = np.pad(self.shares[:, :common, :common], ((0, 0), (0, own), (0, own)))
            alone = np.diag(np.repeat([0.0, 1.0], (common, own)))
            last = self.sources[-1] if self.own else other.sources[-1] if other.own else ""
            kept = [k for k, name in enumerate(self.sources) if name != last]
            changed["sources"] = (*(self.sources[k] for k in kept), *((last,) if own else ()))
            changed["shares"] = np.concatenate([wider[kept], alone[None]] if own else [wider])
        if self.displacement is not None:
            still = np.zeros((own, 2, 3))
            gauge = self.displacement[common + self.own :]
            changed["displacement"] = np.concatenate([self.displacement[:common], still, gauge])
        return changed

    @property
    def calibration_sigma(self) -> Floats:
        """Standard deviation of z (mm) by the rig alone: root sum square of the modes; 0 without any."""
        if self.calibration is None:
            return np.zeros(self.z.shape)
        modes = self.calibration.astype(np.float64)
        return np.asarray(np.sqrt((modes * modes).sum(axis=0)))

    @property
    def total_sigma(self) -> Floats:
        """Standard deviation of z (mm): noise and rig."""
        return np.hypot(self.sigma, self.calibration_sigma)

    def difference(self, other: HeightMap) -> tuple[Floats, Floats]:
        """z less another map's of the same rig, pixel by pixel, and its standard deviation (mm): modes, and
        errors of a rest capture or an anchor in common, cancel as far as they are equal in both. InputError
        where the maps' shapes or rigs differ.
        """
        counts = [
            0 if each.calibration is None else len(each.calibration) - each.own for each in (self, other)
        ]
        if self.z.shape != other.z.shape or counts[0] != counts[1]:
            raise InputError(
                f"difference: maps of {self.z.shape} and {other.z.shape} pixels with {counts[0]} and "
                f"{counts[1]} modes; must be of one rig"
            )
        noise = self._noise_less(other)
        if self.calibration is None or other.calibration is None:
            return self.z - other.z, noise
        modes = self._modes_less(other)["calibration"]
        return self.z - other.z, np.sqrt(noise**2 + np.einsum("rij,rij->ij", modes, modes))

    def displacement_at(self, x: float, y: float) -> Floats:
        """The change of the point (x, y) by one standard deviation of every independent error of the rig,
        (m, 2) mm; (0, 2) where positions are exact."""
        if self.displacement is None:
            return np.zeros((0, 2))
        moved: Floats = self.displacement @ np.array([1.0, x, y])
        return moved

    @property
    def good(self) -> Mask:
        """True where no flag is set."""
        return np.asarray(self.flags == 0)

    @property
    def implausible(self) -> bool:
        """Whether all pixels are flagged since the capture contradicts its scene."""
        return bool((self.flags & HeightFlag.IMPLAUSIBLE).any())

    def resample(self, pitch_mm: float | None = None) -> Grid:
        """The good points on a regular grid of x and y (None: about as fine as the pixels); its sigma is that
        of the height at a fixed x, y, by noise and rig. See `resampling`.
        """
        pitch = natural_pitch(self.x, self.y, self.good) if pitch_mm is None else pitch_mm
        return resample(self.x, self.y, self.z, self.total_sigma, self.good, pitch, self.lean)

    def save(self, path: str | Path) -> None:
        """Write a compressed .npz with the fields' names, maps as float32; `modes` holds `calibration` on
        every `modes_step`-th pixel where such a grid expands to it.
        """
        maps = {name: getattr(self, name) for name in ("x", "y", "z", "sigma", "lean", "shared")}
        arrays: dict[str, Any] = {
            name: None if one is None else np.asarray(one, np.float32) for name, one in maps.items()
        }
        told = notices_to_array(self.notices) if self.notices else None
        arrays |= {"flags": self.flags, "diagnostics": self.diagnostics.to_json(), "notices": told}
        arrays |= {"shares": self.shares, "displacement": self.displacement}
        if self.calibration is not None:
            coarse = coarsened(self.calibration, np.isfinite(self.z))
            arrays |= {"modes": coarse.modes, "modes_step": np.array(coarse.step)}
        arrays |= {"own": np.array(self.own)} if self.own else {}
        arrays |= {"references": np.array(self.references)} if self.references else {}
        arrays |= {} if self.shares is None else {"sources": np.array(self.sources)}
        save_arrays(path, arrays, compressed=True)

    @classmethod
    def load(cls, path: str | Path) -> HeightMap:
        """Read what save() wrote, maps as float64; InputError names the file and the field."""
        arrays = load_arrays(path, _ARRAYS, ("notices", "diagnostics", "sources", "references"))
        diagnostics = Diagnostics("unknown")
        if "diagnostics" in arrays:
            try:
                diagnostics = Diagnostics.from_json(str(arrays["diagnostics"]))
            except (ValueError, TypeError) as error:
                raise InputError(f"{path}: field 'diagnostics' is not readable ({error})") from error
        try:
            known = {name: _doubled(arrays[name]) for name in _ARRAYS}
            notices = notices_from_array(arrays["notices"]) if "notices" in arrays else ()
            modes = arrays.get("calibration")  # as files before 0.1.0 hold them
            if "modes" in arrays:
                step = int(arrays.get("modes_step", 1))
                modes = expanded(CoarseModes(arrays["modes"], step), np.isfinite(known["z"]))
            return cls(
                **known,
                diagnostics=diagnostics,
                lean=_doubled(arrays.get("lean")),
                notices=notices,
                calibration=modes,
                sources=tuple(str(name) for name in np.atleast_1d(arrays.get("sources", ()))),
                shares=arrays.get("shares"),
                displacement=arrays.get("displacement"),
                own=int(arrays.get("own", 0)),
                references=tuple(str(name) for name in np.atleast_1d(arrays.get("references", ()))),
                shared=_doubled(arrays.get("shared")),
            )
        except InputError as error:
            raise InputError(f"{path}: {error}") from error

    def save_tiff(self, path: str | Path) -> None:
        """Write z as float32 TIFF (mm; NaN where it is not good), on the camera's pixels."""
        write_tiff(path, np.where(self.good, self.z, np.nan))

    def save_ply(self, path: str | Path) -> None:
        """Write the good points with their sigma (noise and rig) as a binary PLY mesh of the camera's pixel
        grid."""
        write_ply(path, self.x, self.y, self.z, self.total_sigma, self.good)

    def save_stl(self, path: str | Path) -> None:
        """Write the mesh between the good pixels as binary STL."""
        write_stl(path, self.x, self.y, self.z, self.good)

    def save_xyz(self, path: str | Path) -> None:
        """Write a line x y z (mm) per good pixel."""
        write_xyz(path, self.x, self.y, self.z, self.good)

    def export(self, path: str | Path, pitch_mm: float | None = None) -> None:
        """Write in the format of the suffix, one of HEIGHT_FORMATS; InputError names these.

        X3P, SDF and DAT hold a regular grid of the pitch (None: about as fine as the pixels). NPZ and TIFF do
        so where a pitch is given; else they hold the camera's pixels.
        """
        writer = chosen(path, HEIGHT_FORMATS)
        if not hasattr(self, writer) or (pitch_mm is not None and writer in ("save", "save_tiff")):
            self.resample(pitch_mm).export(path)
        else:
            getattr(self, writer)(path)


def _doubled(values: Any) -> Any:
    """Float32 as float64, in which all sums are made; others unchanged."""
    return values.astype(np.float64) if getattr(values, "dtype", None) == np.float32 else values
