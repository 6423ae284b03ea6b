"""The guard of code lines: its counts, its failures, the file that --accept writes."""

import tomllib
from functools import cache
from pathlib import Path

import pytest

from lab.figures.house import accept, code_lines, house, limits, over, ratchets
from lab.program import run

#: Of the checkout, once.
HOUSE, COUNTED = cache(house), cache(ratchets)
SOURCE = '''"""A docstring
of two lines."""

import math
from os import (
    path,
)

# a comment
_A, _B = 1.0, 2  # two numbers
_C: tuple[int, ...] = (1, 2, 3)
_D = 3 * 4
_WORDS = ("a", 1)
name = 7


def one(x):
    """Docstring."""
    if x and path:

        return math.pi
    return """text
of two lines"""
'''


def checkout(root: Path) -> Path:
    """A part of one file, and one whose file has the same name."""
    for part in ("scene", "decode"):
        (root / part).mkdir()
        (root / part / "one.py").write_text(SOURCE, encoding="utf-8")
    (root / "tests").mkdir()
    (root / "tests/missed_figures.toml").write_text("[[missed]]\ntests = ['a', 'b']\n", encoding="utf-8")
    (root / "house.toml").write_text("installed = 0\n[parts]\n[ratchets]\n", encoding="utf-8")
    return root


def test_code_lines_are_those_of_statements() -> None:
    assert code_lines(SOURCE) == 5 + 5
    assert code_lines('"""Docstring."""\n\n\nimport math\n') == 0


def test_what_is_counted_and_accepted(tmp_path: Path) -> None:
    root = checkout(tmp_path)
    rows, now = [house(part, root) for part in ("scene", "decode")], ratchets(root)
    assert [row.code for row in rows] == [10, 10]
    assert now["named_numbers"] == 2 * (2 + 3 + 1)
    assert (now["repeated_file_names"], now["expected_failures"], now["long_functions"]) == (1, 2, 0)
    accept("a test", rows, now, root)
    written = tomllib.loads((root / "house.toml").read_text(encoding="utf-8"))
    assert written["reason"] == "a test"
    assert "date" in written
    assert limits(root) == {"installed": 20, "scene": 10, "decode": 10} | now


def test_ratchets_never_rise(tmp_path: Path) -> None:
    root = checkout(tmp_path)
    now = ratchets(root)
    accept("first", [house("scene", root)], now, root)
    later = now | {"named_numbers": now["named_numbers"] + 1, "repeated_file_names": 0}
    accept("second", [house("scene", root)], later, root)
    assert limits(root)["named_numbers"] == now["named_numbers"]
    assert limits(root)["repeated_file_names"] == 0
    assert over(later, limits(root)) == {"named_numbers": 1}


def test_a_long_function_or_one_of_many_branches_is_counted(tmp_path: Path) -> None:
    root = checkout(tmp_path)
    for lines, name in ((89, "short"), (90, "long")):
        body = "\n".join(["    pass"] * lines)
        (root / f"decode/{name}.py").write_text(f"def f():\n{body}\n", encoding="utf-8")
    for count, name in ((29, "few"), (30, "many")):
        body = "\n".join(["    if x: pass"] * count)
        (root / f"decode/{name}.py").write_text(f"def f(x):\n{body}\n", encoding="utf-8")
    assert ratchets(root)["long_functions"] == 2


@pytest.mark.parametrize(("name", "code"), [("installed", 1), ("expected_failures", 1), ("decode", 0)])
def test_the_total_and_the_ratchets_fail_a_part_is_listed(
    name: str, code: int, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    roomy = dict.fromkeys([*limits(), *COUNTED()], 10**6) | {name: 1}
    for known, by in (("limits", lambda: roomy), ("house", HOUSE), ("ratchets", COUNTED)):
        monkeypatch.setattr(f"lab.figures.house.{known}", by)
    assert run(["house"]) == code
    assert "+" in capfd.readouterr().out
