"""HeightMap: where the mirror is, how sure that is, and why not where it fails; and its files.

Modes of a rig are smooth maps on every step-th pixel, linear between, in memory as in files.
"""

from __future__ import annotations

import json
import math
from dataclasses import asdict, dataclass, field, fields, replace
from enum import IntFlag
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import scipy.ndimage
import scipy.sparse
from numpy.typing import NDArray

from optolever.arrays import Floats, Mask, require_room
from optolever.contact import Contact
from optolever.decode import Flag
from optolever.errors import InputError
from optolever.files import save_arrays
from optolever.maps import MESHES, chosen, write_tiff
from optolever.notices import Judged, Notice, notices_to_array
from optolever.records import Axes, Comparable, flag_line, plot_maps, span
from optolever.schema import from_json, load_record, require_shapes

from .outputs.resampling import GRID_FORMATS, Grid, Lean, natural_pitch, resample

__all__ = [
    "HEIGHT_FORMATS", "REST_NOISE", "Diagnostics", "HeightFlag", "HeightMap", "Modes", "coarse_step",
    "expanded", "filled", "sum_of_squares",
]  # fmt: skip

#: Suffixes of the files that a height map is written to.
HEIGHT_FORMATS = (*GRID_FORMATS, *MESHES)

#: Source of those own modes that maps of one rest capture have in common.
REST_NOISE = "noise of the rest capture in sag and motion"
_MOST = 1e9  # mm
_SINGLE = ("x", "y", "z", "sigma", "lean", "shared", "free")  # float32 in files


class HeightFlag(IntFlag):
    """Reasons not to trust a height, in addition to the decoder's (bits below 1024); 0 = good.

    NO_ANCHOR: nothing ties the pixel to a known height; CURL: its slopes are those of no surface; STEEP: it
    is reached only across slopes that change too fast between pixels (a cusp, a rim), by which its height may
    be wrong by more than three sigma of the pixels around (in its sigma); NOT_CONVERGED: the last step still
    moved it by more than its sigma, or too many others; SINGULAR: the pattern lies within its noise of the
    mirror or of the ray there, so that there is no normal, or its total sigma exceeds a quarter of the
    mirror's length;
    IMPLAUSIBLE: no rig of the scene's accuracy can have taken the capture (on all pixels).
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
    1: noise alone), None if unknown; components: connected components solved; lost: pixels
    in components without an anchor; chi2: of the slopes' circulation around blocks of pixels, per degree of
    freedom, `freedom` in number (see `circulation`; about 1 if the scene is right, None without a complete
    block); noise: share of the variance by every source (see `uncertainty.sources`), median; slope_sigma:
    median standard deviations of dz/dx and dz/dy by noise, where they were computed.
    """

    method: str
    converged: bool = True
    steps: tuple[float, ...] = ()
    iterations: int = 0
    defect: float | None = None
    components: int = 0
    lost: int = 0
    noise: dict[str, float] = field(default_factory=dict)
    chi2: float | None = None
    freedom: int = 0
    slope_sigma: tuple[float, float] | None = None

    def to_json(self) -> str:
        """As one line of JSON."""
        return json.dumps(asdict(self))

    @classmethod
    def from_json(cls, text: str) -> Diagnostics:
        """The inverse of to_json; unknown entries are skipped."""
        found: Diagnostics = from_json(cls, text, "diagnostics")
        return found


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class HeightMap(Comparable):
    """Mirror points on the camera's pixels, (H, W) each, mm in the mirror's frame.

    x, y, z: NaN where nothing is known; sigma: standard deviation of z at that pixel, whose point then moves
    along the pixel's ray; flags: uint16, 0 = good: the decoder's bits and those of HeightFlag;
    lean: dx/dz and dy/dz along the rays, (2, H, W), or (2, 1, 1) if all are parallel, None if unknown (taken
    as upright); notices: warnings about the map, the correspondence's included; tests: of this
    map, not in files;
    modes: (r, rows, cols) mm on every `modes_step`-th pixel, linear between: change of z by one standard
    deviation of every independent error of the rig, apart from `sigma`; an error is common to all heights.
    None: the scene is exact.
    sources, shares (s, r, r): origins of these errors, in words, and each one's part of their covariance
    (see `budget`); none: not known.
    displacement: (m, 2, 3), m >= r: the change of x and y by one standard deviation of every independent
    error of the rig, an affine field displacement[k] @ (1, x, y) in mm. The first r errors are those of
    `modes`; the others move the map along the mirror and change no height (the gauge). None: x and y are
    exact.
    own: number of the last modes, errors of this capture alone (motion of the rig since the rest
    capture): they do not cancel in a difference of two maps.
    references: names (k,) of the rest capture and the anchors that the map rests on; shared (k, H, W) mm: the
    part of `sigma` that is theirs, common to all maps of the same reference.
    sinking: standard deviation of an even sinking of the mirror, mm, apart from the modes: the picture is
    that of a rig that moved since rest.
    contacts: see `contacts`; None: not looked for.
    free: (H, W) change of z with the anchor's height, of size 1 (median), where an anchor is a guess: the
    middle of a mirror whose edge is not seen; None: it is none.
    """

    x: Annotated[Floats, "H W"]
    y: Annotated[Floats, "H W"]
    z: Annotated[Floats, "H W"]
    sigma: Annotated[Floats, "H W"]
    flags: Annotated[NDArray[np.uint16], "H W"]
    diagnostics: Diagnostics = field(default_factory=lambda: Diagnostics("unknown"))
    lean: Lean | None = None
    notices: tuple[Notice, ...] = ()
    tests: tuple[Judged, ...] = ()
    modes: Annotated[Modes, "r rows cols"] | None = None
    modes_step: int = 1
    sources: tuple[str, ...] = ()
    shares: Annotated[Floats, "s r r"] | None = None
    displacement: Annotated[Floats, "m 2 3"] | None = None
    own: int = 0
    references: tuple[str, ...] = ()
    shared: Annotated[Floats, "k H W"] | None = None
    sinking: float = 0.0
    contacts: tuple[Contact, ...] | None = None
    free: Annotated[Floats, "H W"] | None = None

    def __post_init__(self) -> None:
        require_shapes(self)
        shape, count, step = np.shape(self.z), self.count, self.modes_step
        if step < 1:
            raise InputError(f"height map: modes_step is {step}, must be at least 1")
        if not 0 <= self.own <= count:
            raise InputError(f"height map: own is {self.own}, must be 0 to {count}")
        if not 0 <= self.sinking < math.inf:
            raise InputError(f"height map: sinking is {self.sinking}, must be a length from 0, mm")
        moves = count if self.displacement is None else max(count, len(self.displacement))
        shapes: dict[str, tuple[tuple[int, ...], ...]] = {
            "lean": ((2, *shape), (2, 1, 1)),
            "modes": ((count, *((size - 1) // step + 1 for size in shape)),),
            "displacement": ((moves, 2, 3),),
            "shared": ((len(self.references), *shape),),
        }
        if count:
            shapes["shares"] = ((len(self.sources), count, count),)
        for name, known in shapes.items():
            value = getattr(self, name)
            if value is not None and np.shape(value) not in known:
                must = " or ".join(map(str, known))
                raise InputError(f"height map: {name} has shape {np.shape(value)}, must be {must}")

    def __repr__(self) -> str:
        good = self.good
        rows, cols = good.shape
        names = {flag.value: str(flag.name) for flag in (*Flag, *HeightFlag)}
        lines = [f"HeightMap: {rows} x {cols} pixels, {100 * good.mean():.4g} % good"]
        lines.append(f"  z {span(self.z, good)} mm, sigma {span(self.sigma, good)} mm")
        lines.append(f"  x {span(self.x, good)}, y {span(self.y, good)} mm")
        lines.append("  " + flag_line(self.flags, names))
        method, notices = self.diagnostics.method, len(self.notices)
        return "\n".join([*lines, f"  method {method}, {self.count} modes, {notices} notices"])

    def plot(self, axes: Any = None) -> Axes:
        """Draw z and its standard deviation (noise and rig) of the good pixels with matplotlib; the axes."""
        maps = {"z [mm]": self.z, "sigma [mm]": self.total_sigma}
        return plot_maps({title: np.where(self.good, one, np.nan) for title, one in maps.items()}, axes)

    def __sub__(self, other: HeightMap) -> HeightMap:
        """This map less another one of the same rig, pixel by pixel: sigma is of the difference; modes, and
        errors of a rest capture or an anchor in common, cancel as far as they are equal in both; flags of
        both are joined. x, y and lean are this map's. InputError where the maps' shapes or rigs differ.
        """
        if not isinstance(other, HeightMap):
            return NotImplemented
        counts = [each.count - each.own for each in (self, other)]
        if self.against_rest != other.against_rest:
            cure = "reconstruct both with the same --rest, or none"
            raise InputError(f"difference: one of both maps alone is less a rest capture; {cure}")
        if self.z.shape != other.z.shape or counts[0] != counts[1]:
            raise InputError(
                f"difference: maps of {self.z.shape} and {other.z.shape} pixels with {counts[0]} and "
                f"{counts[1]} modes; must be of one rig"
            )
        variance = np.square(self.sigma) + np.square(other.sigma)
        if self.shared is not None and other.shared is not None:
            for name in set(self.references) & set(other.references):
                one, two = self.references.index(name), other.references.index(name)
                variance = variance - 2 * np.nan_to_num(self.shared[one] * other.shared[two])
        return replace(
            self,
            z=self.z - other.z,
            sigma=np.sqrt(np.maximum(variance, np.square(self.sigma - other.sigma))),
            flags=self.flags | other.flags,
            diagnostics=Diagnostics("difference"),
            notices=tuple(dict.fromkeys((*self._without_rest(other), *self.notices, *other.notices))),
            tests=(),
            references=(),
            shared=None,
            sinking=math.hypot(self.sinking, other.sinking),
            contacts=None,
            free=None,
            **self._modes_less(other),
        )

    def _modes_less(self, other: HeightMap) -> dict[str, Any]:
        """The modes of the difference: common ones less the other's, then those of either capture alone."""
        if self.modes is None or other.modes is None:
            return {"modes": None, "sources": (), "shares": None, "displacement": None, "own": 0}
        common, step = self.count - self.own, self.modes_step
        mine, others = self.modes, other.modes
        if step != other.modes_step:
            mine, others, step = *(np.asarray(each.calibration) for each in (self, other)), 1
        (alone, by_rest), (others_alone, others_rest) = self._own(mine), other._own(others)
        if self._rest() == other._rest():
            both = _differences(by_rest, others_rest)
        else:
            both = np.concatenate([by_rest, others_rest])
        parts = [mine[:common] - others[:common], alone, others_alone, both]
        modes = np.concatenate(parts).astype(np.float32)
        own = len(modes) - common
        changed: dict[str, Any] = {"modes": modes, "modes_step": step, "own": own}
        if self.shares is not None:
            wider = np.pad(self.shares[:, :common, :common], ((0, 0), (0, own), (0, own)))
            ours = np.diag(np.repeat([0.0, 1.0], (common, own)))
            last = self.sources[-1] if self.own else other.sources[-1] if other.own else ""
            kept = [k for k, name in enumerate(self.sources) if name not in (last, REST_NOISE)]
            changed["sources"] = (*(self.sources[k] for k in kept), *((last,) if own else ()))
            changed["shares"] = np.concatenate([wider[kept], ours[None]] if own else [wider])
        if self.displacement is not None:
            still = np.zeros((own, 2, 3))
            gauge = self.displacement[self.count :]
            changed["displacement"] = np.concatenate([self.displacement[:common], still, gauge])
        return changed

    def _own(self, modes: Modes) -> tuple[Floats, Floats]:
        """Own ones of these modes, without and by the rest capture's noise; none where these are zero."""
        own = np.asarray(modes[self.count - self.own :], np.float64)
        if self.shares is None or REST_NOISE not in self.sources:
            return own, own[:0]
        share = self.shares[self.sources.index(REST_NOISE)][-self.own :, -self.own :]
        values, vectors = np.linalg.eigh(share)
        values = np.clip(values, 0.0, 1.0)
        return tuple(
            np.tensordot((vectors * np.sqrt(part)).T, own, 1)[part > 0] for part in (1 - values, values)
        )

    def _without_rest(self, other: HeightMap) -> list[Notice]:
        """Whether errors of a rig stay in the difference, since no rest capture is common to both maps."""
        if self._rest() & other._rest() or not (self.count and other.count):
            return []
        name = "Errors of the rig do not cancel in this difference: its maps have no rest capture in common"
        return [Notice.plain(name, "solve one press against the other: reconstruct --rest")]

    def _rest(self) -> set[str]:
        """The rest capture's name."""
        return {name for name in self.references if name.startswith("rest ")}

    @property
    def count(self) -> int:
        """Number of modes."""
        return 0 if self.modes is None else len(self.modes)

    @property
    def calibration(self) -> Modes | None:
        """The modes on all pixels, (r, H, W) mm; made anew at every call."""
        return None if self.modes is None else expanded(self.modes, self.modes_step, np.isfinite(self.z))

    @property
    def calibration_sigma(self) -> Floats:
        """Standard deviation of z (mm) by the rig alone: root sum square of the modes; 0 without any."""
        if self.modes is None:
            return np.zeros(self.z.shape)
        return np.sqrt(sum_of_squares(self.modes, self.modes_step, self.z.shape))

    @property
    def total_sigma(self) -> Floats:
        """Standard deviation of z (mm): noise, rig, and a sinking of the whole mirror."""
        return np.hypot(np.hypot(self.sigma, self.calibration_sigma), self.sinking)

    def difference(self, other: HeightMap) -> tuple[Floats, Floats]:
        """z of this map less another one, and its standard deviation (mm). Of two presses of one rig
        `reconstruct(press, scene, rest=other)` is more exact: the errors of the rig cancel."""
        change = self - other
        return change.z, change.total_sigma

    @property
    def against_rest(self) -> bool:
        """Whether the map is less a capture at rest."""
        return any(name.startswith("rest ") for name in self.references)

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

    def save(self, path: str | Path, **more: Floats) -> None:
        """Write a compressed .npz with the fields' names, maps as float32; what is empty is left out. more:
        arrays that it also holds."""
        values: dict[str, Any] = {entry.name: getattr(self, entry.name) for entry in fields(self)} | more
        del values["tests"]
        values["notices"] = notices_to_array(self.notices) if self.notices else None
        values["diagnostics"] = self.diagnostics.to_json()
        if self.contacts is not None:
            values["contacts"] = json.dumps([one.to_dict() for one in self.contacts])
        values |= {name: np.asarray(values[name], np.float32) for name in _SINGLE if values[name] is not None}
        save_arrays(path, {name: one for name, one in values.items() if np.size(one)}, compressed=True)

    @classmethod
    def load(cls, path: str | Path) -> HeightMap:
        """Read what save() wrote, maps as float64; InputError names the file and the field."""
        found = load_record(cls, path, ("notices", "diagnostics", "contacts"), tests=lambda _: ())
        for name in ("x", "y", "z"):
            values = getattr(found, name)
            for row, col in np.argwhere(found.good & ~(np.abs(values) <= _MOST))[:1]:
                wrong = f"{name} is {values[row, col]} at pixel ({row}, {col}), which has no flag"
                raise InputError(f"{path}: {wrong}; must be at most {_MOST:g} mm")
        return found

    def export(self, path: str | Path, pitch_mm: float | None = None, **more: Floats) -> None:
        """Write in the format of the suffix, one of HEIGHT_FORMATS; InputError names these. more: see `save`.

        X3P, SDF and DAT hold a regular grid of the pitch (None: about as fine as the pixels). NPZ and TIFF do
        so where a pitch is given; else they hold the camera's pixels.
        """
        suffix = chosen(path, HEIGHT_FORMATS)
        if suffix in MESHES:
            MESHES[suffix](path, self.x, self.y, self.z, self.total_sigma, self.good)
        elif pitch_mm is None and suffix in (".npz", ".tif", ".tiff"):
            self.save(path, **more) if suffix == ".npz" else write_tiff(
                path, np.where(self.good, self.z, np.nan)
            )
        else:
            self.resample(pitch_mm).export(path)


def _differences(one: Floats, other: Floats) -> Floats:
    """Modes (n, ...) less others (m, ...), turned to the least difference: any rotation of modes has their
    covariance."""
    count = max(len(one), len(other))
    first, second = (np.pad(each, ((0, count - len(each)), (0, 0), (0, 0))) for each in (one, other))
    rows = [np.nan_to_num(each).reshape(count, first[0].size if count else 0) for each in (first, second)]
    left, _, right = np.linalg.svd(rows[0] @ rows[1].T)
    return np.asarray(first - np.tensordot(left @ right, second, 1))


#: (r, rows, cols) on every step-th pixel; gaps are filled where step > 1.
Modes = NDArray[np.float32]
_LINES = 75  # rows or columns, at least


def coarse_step(shape: tuple[int, ...]) -> int:
    """Pixels from line to line of the coarse grid of an image."""
    return max(1, min(shape) // _LINES)


def filled(coarse: Floats) -> Modes:
    """The modes, gaps from their nearest neighbours. InputError where one has nothing but gaps."""
    with np.errstate(over="ignore"):  # of a solution that diverges, whose pixels are flagged
        modes = coarse.astype(np.float32)
    nearest, before = (), np.zeros(0, np.bool_)
    for mode in modes:
        gaps = ~np.isfinite(mode)
        if gaps.all():
            raise InputError("calibration: no height is left where a number of the scene is off by its sigma")
        if gaps.any():
            if not np.array_equal(gaps, before):
                found = scipy.ndimage.distance_transform_edt(
                    gaps, return_distances=False, return_indices=True
                )
                nearest, before = tuple(found), gaps
            mode[:] = mode[nearest]
    return modes


def expanded(coarse: Modes, step: int, known: Mask) -> Modes:
    """The modes (r, H, W) on the known pixels, NaN elsewhere."""
    if step == 1:
        return coarse
    require_room("modes", 4 * len(coarse) * known.size)
    rows, cols = (_linear(size, step) for size in known.shape)
    modes = np.full((len(coarse), *known.shape), np.nan, np.float32)
    for mode, nodes in zip(modes, coarse, strict=True):
        mode[known] = (rows @ (cols @ nodes.T).T)[known]
    return modes


def sum_of_squares(coarse: Modes, step: int, shape: tuple[int, ...]) -> Floats:
    """Of the modes in every pixel, (H, W): between nodes a parabola along either axis."""
    if step == 1:
        return np.asarray(np.einsum("rij,rij->ij", coarse, coarse, dtype=np.float64))
    nodes, (down, across) = coarse.astype(np.float64), [_quadratic(size, step) for size in shape]
    squares = np.empty([2 * size - 1 for size in coarse.shape[1:]])
    left, above = nodes[..., :-1] + nodes[..., 1:], nodes[:, :-1] + nodes[:, 1:]
    for part, amid in (
        (squares[::2, ::2], nodes),
        (squares[::2, 1::2], 0.5 * left),
        (squares[1::2, ::2], 0.5 * above),
        (squares[1::2, 1::2], 0.25 * (left[:, :-1] + left[:, 1:])),
    ):
        np.einsum("rij,rij->ij", amid, amid, out=part)
    return np.asarray(np.maximum(down @ (across @ squares.T).T, 0.0))


def _places(size: int, step: int) -> tuple[NDArray[np.intp], Floats]:
    """Of every pixel the node before it, and how far it is towards the next one; constant beyond the last."""
    last = (size - 1) // step
    place = np.minimum(np.arange(size) / step, last)
    low = np.minimum(place.astype(np.intp), max(0, last - 1))
    return low, place - low


def _linear(size: int, step: int) -> scipy.sparse.csr_array:
    """Weights (size, nodes) of linear interpolation."""
    low, share = _places(size, step)
    return _weights([low, low + 1], [1 - share, share], (size - 1) // step + 1)


def _quadratic(size: int, step: int) -> scipy.sparse.csr_array:
    """Weights (size, 2 nodes - 1) of the parabola through two nodes and the value amid them."""
    low, s = _places(size, step)
    shares = [(1 - s) * (1 - 2 * s), 4 * s * (1 - s), s * (2 * s - 1)]
    return _weights([2 * low, 2 * low + 1, 2 * low + 2], shares, 2 * ((size - 1) // step) + 1)


def _weights(nodes: list[NDArray[np.intp]], shares: list[Floats], count: int) -> scipy.sparse.csr_array:
    at = np.tile(np.arange(nodes[0].size), len(nodes)), np.minimum(np.concatenate(nodes), count - 1)
    return scipy.sparse.csr_array((np.concatenate(shares), at), shape=(nodes[0].size, count))
