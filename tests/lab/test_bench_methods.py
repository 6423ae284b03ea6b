"""The table of methods: every one is in it, its numbers are those of the method."""

import math

import pytest

from lab.bench import methods as table
from lab.bench.methods import MethodRow, run_methods
from optolever.reconstruct import integrator_names

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
