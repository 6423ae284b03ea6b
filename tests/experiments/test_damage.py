"""Damage goes on whatever it meets, and most of it leaves files that can be read."""

import tomllib
from contextlib import suppress
from pathlib import Path

import numpy as np

from optolever.experiments.damage import damage
from optolever.patterns import sequence


def test_damaged_toml(tmp_path: Path) -> None:
    sequence("gray+phase", 24, 32).save(tmp_path / "whole.toml")
    text, readable = (tmp_path / "whole.toml").read_text(encoding="utf-8"), 0
    for number in range(100):
        path = tmp_path / "damaged.toml"
        path.write_text(text, encoding="utf-8")
        damage(np.random.default_rng(number), path)
        with suppress(ValueError):
            readable += tomllib.loads(path.read_text(encoding="utf-8")) != tomllib.loads(text)
    assert readable > 50
