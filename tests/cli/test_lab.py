"""Commands of the laboratory."""

import os
from pathlib import Path

import pytest

from optolever.cli import run


def test_damaged_inputs_end_in_one_line_or_a_result_that_holds(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    """100 cases; 1000 where OPTOLEVER_SLOW is set."""
    cases = "1000" if os.environ.get("OPTOLEVER_SLOW") else "100"
    code = run(["lab", "fuzz", "--cases", cases, "--seed", "7", "--json", str(tmp_path / "f.json")])
    assert code == 0, capfd.readouterr().out
    assert (tmp_path / "f.json").is_file()
