"""The table of methods: every one is in it, its numbers are those of the method."""

import json
import math
from dataclasses import asdict

import pytest

from lab.bench import methods as table
from lab.bench.methods import MethodRow, run_methods
from optolever.reconstruct import integrator_names, method_names

SIZE = (40, 48)


@pytest.fixture(scope="module")
def fields() -> list[MethodRow]:
    return run_methods(SIZE, ("integrate",), integrator_names())


def row(rows: list[MethodRow], case: str, method: str) -> MethodRow:
    (found,) = [row for row in rows if row.case == case and row.method == method]
    return found


def test_every_integrator_on_every_field(fields: list[MethodRow]) -> None:
    assert {row.method for row in fields} == set(integrator_names())
    assert {row.case for row in fields} == set(table.FIELDS)
    for one in fields:
        assert bool(one.why) == math.isnan(one.error)
    assert "rectangle" in row(fields, "hole", "dct4").why


def test_mirrors() -> None:
    rows = run_methods(SIZE, ("reconstruct, smooth", "reconstruct, holes"), ("coupled", "march", "paper"))
    cases = {row.case for row in rows}
    assert cases == {"smooth", "smooth, known point", "smooth, noise 0.05 px", "holes"}
    noisy = row(rows, "smooth, noise 0.05 px", "coupled")
    assert 0.3 < noisy.sigma_ratio < 3
    assert noisy.error < 0.05
    assert row(rows, "holes", "coupled").flagged > 0.01
    assert "rectangle" in row(rows, "holes", "march").why
    assert math.isnan(row(rows, "smooth", "paper").silent)
    assert row(rows, "smooth, known point", "coupled").error < 1e-3
    assert "coupled" in method_names()
    json.dumps([asdict(row) for row in rows])
