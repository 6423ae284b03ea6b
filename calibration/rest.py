"""The mirror at rest, solved once and kept with the rig: dents are z - h0, and what has moved since is told.

`[rest]` in the rig's TOML names the .npz beside it: the height map at rest and the places that it was solved
from, by which later captures of the same pixels are compared.
"""

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import tomli_w
from numpy.typing import NDArray

from optolever.decode import Correspondence
from optolever.errors import InputError
from optolever.files import atomic_file, together
from optolever.notices import Notice
from optolever.reconstruct import HeightMap
from optolever.scene import load

__all__ = ["RestMap", "load_rest", "rig_table", "store_rest", "write_section"]

Floats = NDArray[np.float64]

_BLOCK = 16  # pixels on a side, over which squares are averaged
_UNTOUCHED = 0.1  # share of the mirror that a capture is taken to show untouched
_CHI = 1.5  # of the rest: CALIBRATION.md


@dataclass(frozen=True, slots=True, eq=False)
class RestMap:
    """height: of the mirror at rest; seen: the correspondence that it was solved from."""

    height: HeightMap
    seen: Correspondence

    def dent(self, height: HeightMap) -> tuple[Floats, Floats]:
        """z less the rest's (H, W), and its standard deviation (mm), errors of the rig in it. Good where both
        are."""
        change, sigma = height.difference(self.height)
        good = height.good & self.height.good
        return np.where(good, change, np.nan), np.where(good, sigma, np.nan)

    def chi(self, correspondence: Correspondence) -> float:
        """How far the untouched part of the mirror looks elsewhere than at rest, over its noise: 1 where it
        has not moved. Of blocks of pixels the least moved tenth is taken as untouched; NaN without any pixel.
        """
        rest, now = self.seen, correspondence
        if now.u.shape != rest.u.shape:
            raise InputError(f"rest map: {rest.u.shape} pixels, the correspondence has {now.u.shape}")
        both = rest.good & now.good
        with np.errstate(invalid="ignore", divide="ignore"):
            squares = [
                (getattr(now, axis) - getattr(rest, axis)) ** 2
                / (getattr(now, f"sigma_{axis}") ** 2 + getattr(rest, f"sigma_{axis}") ** 2)
                for axis in ("u", "v")
            ]
        square = np.where(both, 0.5 * (squares[0] + squares[1]), 0.0)
        count = _block_sums(both.astype(np.float64))
        used = count >= 0.5 * _BLOCK**2
        if not used.any():
            return float("nan")
        means = np.sort(_block_sums(square)[used] / count[used])
        return float(np.sqrt(means[: max(1, int(_UNTOUCHED * len(means)))].mean()))

    def notices(self, correspondence: Correspondence) -> tuple[Notice, ...]:
        """Of a capture whose least moved part is no longer where it was at rest."""
        chi = self.chi(correspondence)
        if not chi > _CHI:
            return ()
        cure = "nothing of the mirror is where it was at rest: capture it untouched and run `optolever rest`"
        return (Notice("chi of the rest, drift since it was stored", chi, _CHI, cure),)


def store_rest(rig: str | Path, rest: RestMap) -> Path:
    """Write the map beside the rig's TOML, which names it from then on; the .npz's path."""
    file = Path(rig)
    beside, places = file.with_suffix(".rest.npz"), file.with_suffix(".rest_places.npz")
    with together():
        rest.height.save(beside)
        rest.seen.save(places)
        write_section(file, "rest", {"height": beside.name, "places": places.name})
    return beside


def load_rest(rig: str | Path) -> RestMap | None:
    """The map that a rig's TOML names; None without one. InputError names the file that is wrong."""
    file = Path(rig)
    if not file.is_file():  # a preset's name
        return None
    section = rig_table(file).get("rest")
    if section is None:
        return None
    names = [section.get(name) for name in ("height", "places")] if isinstance(section, Mapping) else []
    beside = [file.parent / name for name in names if isinstance(name, str)]
    if len(beside) != 2:
        raise InputError(f"{file}: [rest] must name the files height and places; run `optolever rest`")
    height, seen = HeightMap.load(beside[0]), Correspondence.load(beside[1])
    if height.z.shape != seen.u.shape:
        raise InputError(f"{file}: [rest] height has {height.z.shape} pixels, places {seen.u.shape}")
    return RestMap(height, seen)


def rig_table(file: Path) -> dict[str, Any]:
    """All that a rig's TOML holds. InputError of a file that is no scene."""
    load(file)
    return tomllib.loads(file.read_text(encoding="utf-8"))


def write_section(file: Path, name: str, section: Mapping[str, Any]) -> None:
    """A rig's TOML with another section of that name."""
    table = rig_table(file) | {name: section}
    with atomic_file(file) as temporary:
        temporary.write_bytes(tomli_w.dumps(table).encode())


def _block_sums(values: Floats) -> Floats:
    """Sums over whole blocks of pixels."""
    rows, cols = (size // _BLOCK for size in values.shape)
    whole = values[: rows * _BLOCK, : cols * _BLOCK]
    sums: Floats = whole.reshape(rows, _BLOCK, cols, _BLOCK).sum(axis=(1, 3))
    return sums
