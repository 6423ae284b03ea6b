"""Names that options take: --list of commands."""

from collections.abc import Container, Mapping
from pathlib import Path
from typing import Any

import optolever as ol

from .printing import table, write_json


def print_names(kinds: Container[str], scene_name: str, json_path: Path | None) -> None:
    """Print names of some kinds with parameters and defaults, dents as of a scene; write all of them.

    A parameter without a value must be given (path) or follows from the others.
    """
    scene = ol.scene.load(scene_name)
    names: dict[str, dict[str, Mapping[str, Any]]] = {
        "scenes": {name: {} for name in ol.scene.preset_names()},
        "sequences": {name: ol.patterns.sequence_parameters(name) for name in ol.patterns.sequence_names()},
        "dents": {name: ol.scene.dent_parameters(name, scene) for name in ol.scene.dent_names()},
    }
    write_json(json_path, {kind: list(each) for kind, each in names.items()} | {"parameters": names})
    for kind, each in names.items():
        if kind in kinds:
            where = f", on {scene.name} (mm)" if kind == "dents" else ""
            table(f"{kind.capitalize()}{where}", {name: _text(values) for name, values in each.items()})


def _text(values: Mapping[str, Any]) -> str:
    """name=value as an option takes it."""
    return ", ".join(key if value is None else f"{key}={_value(value)}" for key, value in values.items())


def _value(value: Any) -> str:
    if isinstance(value, tuple):
        return "/".join(map(_value, value))
    if isinstance(value, bool):
        return str(value).lower()
    return f"{value:.4g}" if isinstance(value, float) else str(value)
