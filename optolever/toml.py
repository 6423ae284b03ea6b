"""The one place where TOML is read: with or without a byte order mark; what is no TOML is one line."""

import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import tomli_w

from optolever.errors import InputError, require_file

__all__ = ["read_toml", "toml_text"]


def read_toml(path: str | Path) -> dict[str, Any]:
    """The tables of a TOML file in UTF-8. InputError, which names the file, if there is none or it is no
    TOML."""
    require_file(path)
    try:
        return tomllib.loads(Path(path).read_text(encoding="utf-8-sig"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: not readable as TOML in UTF-8: {error}") from error


def toml_text(table: Mapping[str, Any]) -> str:
    """Tables as TOML, a list of numbers on one line."""
    return tomli_w.dumps(table).replace("[\n    ", "[").replace(",\n    ", ", ").replace(",\n]", "]")
