"""A rig's TOML: the scene's keys, and the sections of other parts (see `writing.FOREIGN`)."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import tomli_w

from optolever.files import atomic_file
from optolever.toml import read_toml

from .reading import load

__all__ = ["rig_table", "write_sections"]


def rig_table(file: str | Path) -> dict[str, Any]:
    """All tables of a rig's TOML. InputError if the file is no scene."""
    load(file)
    return read_toml(file)


def write_sections(file: str | Path, sections: Mapping[str, Mapping[str, Any]]) -> None:
    """Replace sections of a rig's TOML by name; all others stay. InputError if the file is no scene."""
    table = rig_table(file) | {name: dict(section) for name, section in sections.items()}
    with atomic_file(Path(file)) as temporary:
        temporary.write_bytes(tomli_w.dumps(table).encode())
