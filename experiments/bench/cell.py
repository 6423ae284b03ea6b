"""Cell: one measurement of a grid, with a key and a seed; Grid: the cells of a TOML file; the default grid of
`optolever bench`. Row: the result of a cell, as plain numbers.
"""

import csv
import hashlib
import io
import json
import math
import re
from collections.abc import Callable, Iterable, Iterator
from dataclasses import asdict, dataclass, field, fields, replace
from itertools import product
from pathlib import Path
from typing import Any

from optolever.errors import InputError
from optolever.projector import RENDERERS
from optolever.toml import read_toml

from ..faults import Faults
from ..own_sequence import source_digest

Size = tuple[int, int]
DONE, ABSENT, USELESS, FAILED = "done", "not installed", "not applicable", "failed"
TIMINGS = (
    *("render_seconds", "decode_seconds", "floor_seconds", "reconstruct_seconds"),
    *("decode_bytes", "reconstruct_bytes"),
)
METRICS = (
    "height_rms_rel",
    "height_p95_rel",
    "height_max_rel",
    "height_rms_mm",
    "peak_depth_mm",
    "sigma_ratio_height",
    "sigma_ratio_u",
    "sigma_ratio_v",
    "u_rms_px",
    "v_rms_px",
    "flagged_share",
    "silent_share",
    "decode_silent_share",
    "unflagged_invisible",
)
COLUMNS = (
    *("scene", "rows", "cols", "dent", "sequence", "noise", "seed", "solver", "renderer"),
    *("lag", "gamma", "flicker", "blur"),
    *("status", "why", "kind", "frames", "display_seconds", *TIMINGS, *METRICS),
)


NO_FAULTS = Faults()


@dataclass(frozen=True, slots=True)
class Cell:
    """One measurement: scene, dent, sequence, noise, decoder, solver.

    size: (rows, cols) of the camera, None: the scene's; dent: '' is the scene's; sequence: text of
    `own_sequence` (a .toml file or module:function, too), followed by '@DECODER' (a name or module:function)
    for a decoder other than this package's; 'exact': the true correspondence. noise: 8-bit levels. faults: of
    display and light.
    """

    scene: str
    size: Size | None
    dent: str
    sequence: str
    noise: float
    seed: int
    solver: str
    renderer: str = "auto"
    faults: Faults = NO_FAULTS

    @property
    def shown(self) -> str:
        """The sequence without its decoder."""
        return self.sequence.partition("@")[0]

    @property
    def decoder(self) -> str:
        """Name of the decoder."""
        name = self.sequence.partition("@")[2]
        return name or ("exact" if self.shown == "exact" else "optolever")

    @property
    def place(self) -> tuple[Any, ...]:
        """Key common to all cells of one mirror: scene, size, dent, faults."""
        return self.scene, self.size, self.dent, self.faults

    @property
    def frames(self) -> tuple[Any, ...]:
        """Key common to all cells that use the same frames."""
        return (*self.place, self.shown, self.noise, self.seed, self.renderer)

    @property
    def capture_seed(self) -> int:
        """Seed of the noise, equal for all decoders and solvers of the same frames."""
        frames = (self.scene, self.size, self.dent, self.shown, self.noise, self.seed)
        return int.from_bytes(_digest([*frames, *self._files()])[:4])

    @property
    def key(self) -> str:
        """Name of the cell's result file: a digest of all fields and of the files named in them."""
        return _digest([asdict(self), *self._files()]).hex()[:20]

    def _files(self) -> list[str]:
        return [source_digest(self.scene), source_digest(self.shown)]

    def to_dict(self) -> dict[str, Any]:
        """Plain JSON types."""
        return asdict(self)

    @classmethod
    def from_dict(cls, plain: dict[str, Any]) -> "Cell":
        """Inverse of to_dict."""
        size = plain["size"]
        faults = Faults(**plain.get("faults", {}))
        return cls(
            **{**plain, "size": None if size is None else (int(size[0]), int(size[1])), "faults": faults}
        )


def grouped(cells: Iterable[Cell]) -> list[tuple[Cell, ...]]:
    """Cells grouped by the frames that they use, in order of first appearance."""
    groups: dict[tuple[Any, ...], list[Cell]] = {}
    for cell in cells:
        groups.setdefault(cell.frames, []).append(cell)
    return [tuple(sorted(group, key=lambda cell: cell.decoder)) for group in groups.values()]


@dataclass(frozen=True, slots=True)
class Grid:
    """Every combination of these; lags to blurs: see Faults, None is the scene's value; refresh of the
    display (Hz) and exposure_ms of a frame determine the display time of a sequence."""

    scenes: tuple[str, ...]
    sequences: tuple[str, ...]
    solvers: tuple[str, ...] = ("coupled",)
    dents: tuple[str, ...] = ("",)
    sizes: tuple[Size | None, ...] = (None,)
    noises: tuple[float, ...] = (1.0,)
    seeds: tuple[int, ...] = (0,)
    renderer: str = "auto"
    refresh: float = 60.0
    lags: tuple[float, ...] = (0.0,)
    gammas: tuple[float | None, ...] = (None,)
    flickers: tuple[float | None, ...] = (None,)
    blurs: tuple[float | None, ...] = (None,)
    exposure_ms: float = 0.0

    @property
    def rate(self) -> float:
        """Frames per second: each lasts an integer number of refreshes, at least one and its exposure."""
        return self.refresh / max(1, math.ceil(1e-3 * self.exposure_ms * self.refresh - 1e-9))

    def cells(self) -> list[Cell]:
        """All combinations without duplicates; the exact correspondence has no noise and occurs once."""
        return list(dict.fromkeys(self._cells()))

    def _cells(self) -> Iterator[Cell]:
        axes = (self.scenes, self.sizes, self.dents, self.sequences, self.noises, self.seeds, self.solvers)
        faults = [Faults(*each) for each in product(self.lags, self.gammas, self.flickers, self.blurs)]
        for values, found in product(product(*axes), faults):
            cell = Cell(*values, renderer=self.renderer, faults=found)
            yield replace(cell, noise=0.0, seed=0) if cell.decoder == "exact" else cell


#: Periods of 20, 22 and 25 px repeat together after 1100 px, more than any pattern of a 512 x 512 camera.
_PERIODS = "periods=20/22/25"
#: A typical choice of `optolever design`: three periods of n, n - 1 and n - sqrt(n) fringes, here on up to
#: 1122 px (n = 1122 / 8).
_DESIGNED = "phase:steps=3,periods=8.73782/8.05745/8"

DEFAULT_GRID = Grid(
    scenes=("paper-simulation", "prism48", "monitor-mirror"),
    sizes=((512, 512),),
    sequences=(
        "exact",
        "gray+phase",
        "gray+phase:steps=8",
        "gray+phase:steps=3,period=16",
        "phase",
        f"phase:steps=3,{_PERIODS}",
        "phase:steps=3,periods=576/64/7",
        _DESIGNED,
        f"{_DESIGNED}@fringes",
        f"phase:steps=4,{_PERIODS}",
        "gray",
        "gray@cv2",
        "xor-gray",
        "binary",
        "stripe:step=8",
        "crossed:period=10",
        "lattice",
    ),
    solvers=("coupled", "paper", "paper-drops", "decoupled", "mbipy-frankot", "mbipy-dct"),
)


def load_grid(path: str | Path) -> Grid:
    """A grid from TOML: lists named like Grid's fields, sizes as 'ROWSxCOLS' or 'own'.

    InputError names the file, the field and its value.
    """
    plain = read_toml(path)
    known = [field.name for field in fields(Grid)]
    for name in plain:
        if name not in known:
            raise InputError(f"{path}: unknown field {name!r}, known are {', '.join(known)}")
    for name in ("scenes", "sequences"):
        if name not in plain:
            raise InputError(f"{path}: {name} is missing, must be a list of names")
    values = {name: _value(path, name, value) for name, value in plain.items()}
    return Grid(**values)


def _is_number(value: Any, least: float, most: float = math.inf) -> bool:
    known = isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
    return known and least <= value <= most


def _is_size(value: Any) -> bool:
    found = re.fullmatch(r"(\d+)x(\d+)", str(value))
    return value == "own" or (found is not None and min(map(int, found.groups())) >= 8)


def _size(text: str) -> Size | None:
    rows, _, cols = text.partition("x")
    return None if text == "own" else (int(rows), int(cols))


#: Field -> the requirement on its entries, its check, its conversion; other fields are text.
_FIELDS: dict[str, tuple[str, Callable[[Any], bool], Callable[[Any], Any]]] = {
    "sizes": ("'own' or ROWSxCOLS with at least 8 each", _is_size, _size),
    "noises": ("a number of at least 0", lambda value: _is_number(value, 0.0), float),
    "seeds": ("whole numbers of at least 0", lambda value: type(value) is int and value >= 0, int),
    "lags": ("a share of at least 0, below 1", lambda value: _is_number(value, 0.0, 0.999), float),
    "gammas": ("a number above 0", lambda value: _is_number(value, 1e-3, 100.0), float),
    "flickers": ("a share of at least 0, below 1", lambda value: _is_number(value, 0.0, 0.999), float),
    "blurs": ("cells of at least 0", lambda value: _is_number(value, 0.0), float),
    "exposure_ms": ("ms of at least 0", lambda value: _is_number(value, 0.0), float),
    "refresh": ("0.001 to 1e6 Hz", lambda value: _is_number(value, 1e-3, 1e6), float),
    "renderer": (f"one of {', '.join(RENDERERS)}", lambda value: value in RENDERERS, str),
}
_TEXT = "text", lambda value: isinstance(value, str), str


def _value(path: str | Path, name: str, value: Any) -> Any:
    must, holds, read = _FIELDS.get(name, _TEXT)
    single = name in ("refresh", "renderer", "exposure_ms")
    if not single and (not isinstance(value, list) or not value):
        raise InputError(f"{path}: {name} is {value!r}, must be a list with at least one entry")
    entries = [value] if single else value
    for entry in entries:
        if not holds(entry):
            raise InputError(f"{path}: {name} holds {entry!r}, must hold {must}")
    return read(value) if single else tuple(read(entry) for entry in entries)


def _digest(value: Any) -> bytes:
    return hashlib.sha256(json.dumps(value, sort_keys=True).encode()).digest()


@dataclass(frozen=True, slots=True)
class Row:
    """One cell's result.

    status: done | not installed | not applicable | failed, and why; kind: own | paper | peer | floor (exact
    correspondence); frames: number of frames, without a rest capture; timings: render_, decode_,
    reconstruct_seconds, floor_seconds (reading the frames and writing as much as a decoder does) and peak
    bytes above the stage's inputs (decode_bytes, reconstruct_bytes); metrics: see `measures.measures`;
    unknown values are absent.
    """

    cell: Cell
    status: str
    why: str = ""
    kind: str = "own"
    frames: int = 0
    timings: dict[str, float] = field(default_factory=dict)
    metrics: dict[str, float] = field(default_factory=dict)

    @property
    def done(self) -> bool:
        """True if the cell has results."""
        return self.status == DONE

    @property
    def compute_seconds(self) -> float:
        """Decode and reconstruct; NaN if one is unknown."""
        return sum(self.timings.get(f"{name}_seconds", math.nan) for name in ("decode", "reconstruct"))

    @property
    def error(self) -> float:
        """Rms height error over the peak depth; NaN without one."""
        return self.metrics.get("height_rms_rel", math.nan)

    def display_seconds(self, refresh: float) -> float:
        """Display time of the frames, one per refresh."""
        return self.frames / refresh

    def numbers(self) -> dict[str, Any]:
        """The reproducible values: all but the timings."""
        return {"status": self.status, "frames": self.frames, **self.metrics}

    def to_dict(self) -> dict[str, Any]:
        """Plain JSON types; NaN stays NaN (see `plain`)."""
        return {**asdict(self), "cell": self.cell.to_dict()}

    @classmethod
    def from_dict(cls, record: dict[str, Any]) -> "Row":
        """Inverse of to_dict; None becomes NaN."""
        numbers = {
            name: {key: math.nan if value is None else float(value) for key, value in record[name].items()}
            for name in ("timings", "metrics")
        }
        return cls(**{**record, **numbers, "cell": Cell.from_dict(record["cell"])})

    def flat(self, refresh: float) -> dict[str, Any]:
        """One value per name of COLUMNS; None where unknown."""
        cell = self.cell.to_dict()
        rows, cols = cell.pop("size") or (None, None)
        cell |= cell.pop("faults")
        shown = {"rows": rows, "cols": cols, "display_seconds": self.display_seconds(refresh)}
        told = {name: getattr(self, name) for name in ("status", "why", "kind", "frames")}
        values = cell | shown | told | self.timings | self.metrics
        known = {k: v for k, v in values.items() if not isinstance(v, float) or math.isfinite(v)}
        return {name: known.get(name) for name in COLUMNS}


def csv_text(rows: Iterable[Row], refresh: float) -> str:
    """All rows as CSV under a header; unknown values are empty."""
    stream = io.StringIO()
    writer = csv.DictWriter(stream, COLUMNS, lineterminator="\n")
    writer.writeheader()
    writer.writerows(row.flat(refresh) for row in rows)
    return stream.getvalue()
