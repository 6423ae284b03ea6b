"""The mirror at rest, solved once and stored with the rig: dents are z - h0; drift since then is detected.

`[rest]` in the rig's TOML names two .npz in its folder: the height map at rest, and the correspondence of its
capture, with which later captures are compared pixel by pixel.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from optolever.decode import Correspondence
from optolever.errors import InputError
from optolever.files import together
from optolever.notices import Notice
from optolever.reconstruct import HeightMap, unpressed
from optolever.scene import rig_table, write_sections

__all__ = ["RestMap", "load_rest", "store_rest"]

Floats = NDArray[np.float64]

_DRIFT = 3.0  # standard deviations


@dataclass(frozen=True, slots=True, eq=False)
class RestMap:
    """height: the height map of the mirror at rest; seen: the correspondence of its capture."""

    height: HeightMap
    seen: Correspondence

    def dent(self, height: HeightMap) -> tuple[Floats, Floats]:
        """Height above the mirror at rest (H, W) and its standard deviation (mm), errors of the rig included.
        NaN unless both maps are good."""
        change, sigma = height.difference(self.height)
        good = height.good & self.height.good
        return np.where(good, change, np.nan), np.where(good, sigma, np.nan)

    def notices(self, correspondence: Correspondence) -> tuple[Notice, ...]:
        """Notice of drift of the rig since the map was stored, estimated from the undeformed part."""
        quiet, px, size = unpressed(correspondence, self.seen)
        cure = "dents by reconstruct --change hold that motion: capture it untouched, `optolever rest`"
        if not quiet.any():
            name = (
                "The rest map was stored for another pose, or all of the mirror is pressed: drift is unknown"
            )
            return (Notice(name, float("nan"), float("nan"), cure),)
        if not size > _DRIFT:
            return ()
        name = f"The rig has drifted since its rest map was stored, by {px:.2g} pattern pixels (rms); sigma"
        return (Notice(name, size, _DRIFT, cure),)


def store_rest(rig: str | Path, rest: RestMap) -> Path:
    """Write the map into the folder of the rig's TOML, and its name into the TOML; the .npz's path."""
    file = Path(rig)
    beside, places = file.with_suffix(".rest.npz"), file.with_suffix(".rest_places.npz")
    with together():
        rest.height.save(beside)
        rest.seen.save(places)
        write_sections(file, {"rest": {"height": beside.name, "places": places.name}})
    return beside


def load_rest(rig: str | Path) -> RestMap | None:
    """The map that a rig's TOML names; None without one. InputError names the wrong file."""
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
