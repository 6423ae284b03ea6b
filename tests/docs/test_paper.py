"""The paper's tables, by examples/paper/tables.py, against the printed ones."""

import importlib.util
import sys
from pathlib import Path
from types import ModuleType

import pytest

#: Law, equations, and PAPER.md's drops, rises and mean of the smooth dent.
PRINTED = (
    ("reflection", "reflection sign, gamma 0", ("0.235", "0.66", "0.32")),
    ("reflection", "reflection sign, gamma kept", ("0.029", "0.28", "0.145")),
    ("print", "printed sign, gamma 0", ("0.645", "0.32", "0.34")),
    ("print", "printed sign, gamma kept", ("0.033", "0.035", "0.0030")),
)


@pytest.fixture(scope="module")
def tables(root: Path) -> ModuleType:
    spec = importlib.util.spec_from_file_location("paper_tables", root / "examples" / "paper" / "tables.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules["paper_tables"] = module
    spec.loader.exec_module(module)
    return module


def test_tables(tables: ModuleType) -> None:
    """To half a unit of the last printed digit; the dense solver beats every series of the paper."""
    rows = list(tables.tables(64, renderer="numpy"))
    found = {(row.case, row.data, row.law, row.method): row for row in rows}
    for law, equations, printed in PRINTED:
        row = found["smooth", "exact", law, f"lattice, {equations}"]
        for name, digits in zip(("drops", "rises", "mean"), printed, strict=True):
            assert abs(row.errors[name] - float(digits)) <= 0.51 * 10.0 ** -len(digits.partition(".")[2])
    for case in tables.CASES:
        paper = found[case, "exact", "reflection", "pixels, reflection sign, gamma kept"]
        assert found[case, "exact", "reflection", "pixels, dense solver"].field < paper.field / 10
