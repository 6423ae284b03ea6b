"""Commands of the laboratory."""

from pathlib import Path

import pytest

from optolever.cli import run


@pytest.mark.parametrize("cases", [20, pytest.param(1000, marks=pytest.mark.slow)])
def test_damaged_inputs_end_in_one_line_or_a_result_that_holds(
    cases: int, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "f.json"
    code = run(["lab", "fuzz", "--cases", str(cases), "--seed", "7", "--json", str(path)])
    assert code == 0, capfd.readouterr().out
    assert path.is_file()
