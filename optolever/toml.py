"""The one place where TOML is read: with or without a byte order mark; what is no TOML is one line."""

import re
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import tomli_w

from optolever.errors import InputError, damage_of, require_file

__all__ = ["read_toml", "toml_text"]


def read_toml(path: str | Path) -> dict[str, Any]:
    """The tables of a TOML file in UTF-8. InputError, which names the file, if there is none or it is no
    TOML."""
    from optolever.files import latest  # NumPy only where a file is read

    newest = latest(path)
    require_file(newest)
    try:
        text = newest.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(
            f"{path}: not readable as TOML: {damage_of(error)}; save it as text in UTF-8"
        ) from error
    try:
        return tomllib.loads(text)
    except (ValueError, RecursionError) as error:
        at = re.search(r"at line (\d+)", str(error))
        line = (
            text.splitlines()[int(at[1]) - 1].strip()
            if at and 0 < int(at[1]) <= len(text.splitlines())
            else ""
        )
        comma = re.search(r"=\s*-?\d+,\d", line)
        cure = "; write numbers with a point" if comma else ""
        raise InputError(
            f"{path}: not readable as TOML: {error}{f': {line:.60}' if line else ''}{cure}"
        ) from error


def toml_text(table: Mapping[str, Any]) -> str:
    """Tables as TOML, a list of numbers on one line."""
    return tomli_w.dumps(table).replace("[\n    ", "[").replace(",\n    ", ", ").replace(",\n]", "]")
