"""The mirror at rest, stored with its rig: heights are those above it.

`[rest]` in the rig's TOML names the .npz, in its folder, of the correspondence of its capture.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from optolever.decode import Correspondence
from optolever.errors import InputError
from optolever.files import together
from optolever.scene import rig_table, write_sections

__all__ = ["load_rest", "store_rest"]


def store_rest(rig: str | Path, seen: Correspondence) -> Path:
    """Write what was decoded from the mirror at rest into the folder of the rig's TOML, and its name into the
    TOML; the .npz's path."""
    file = Path(rig)
    places = file.with_suffix(".rest_places.npz")
    with together():
        seen.save(places)
        write_sections(file, {"rest": {"places": places.name}})
    return places


def load_rest(rig: str | Path) -> Correspondence | None:
    """The correspondence of the mirror at rest that a rig's TOML names; None without one. InputError names
    the wrong file."""
    file = Path(rig)
    if not file.is_file():  # a preset's name
        return None
    section = rig_table(file).get("rest")
    if section is None:
        return None
    name = section.get("places") if isinstance(section, Mapping) else None
    if not isinstance(name, str):
        raise InputError(f"{file}: [rest] must name the file places; run `optolever reconstruct --keep-rest`")
    return Correspondence.load(file.parent / name)
