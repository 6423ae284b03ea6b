"""Figures that the decoder is known to miss: each with its reason, listed beside this file."""

import tomllib
from pathlib import Path

import pytest

_LISTED = Path(__file__).with_name("missed_figures.toml")


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark listed tests as expected to fail. One that passes is told (XPASS) and goes from the list."""
    missed = tomllib.loads(_LISTED.read_text(encoding="utf-8"))
    for item in items:
        for group in missed["missed"]:
            if any(item.nodeid.startswith(prefix) for prefix in group["tests"]):
                item.add_marker(pytest.mark.xfail(reason=group["reason"], strict=False))
