"""limits.toml, and the cases that it lists."""

import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

LIMITS: dict[str, Any] = tomllib.loads(Path(__file__).with_name("limits.toml").read_text(encoding="utf-8"))


def cases() -> Iterator[tuple[str, list[str], dict[str, Any]]]:
    """Name, codes and fields of World of every effect."""
    yield "clean", list(LIMITS["clean"]["codes"]), {}
    for group in ("reflectance", "faults", "order", "measured"):
        for name, world in LIMITS[group]["effects"].items():
            yield name, LIMITS[group]["codes"], world
