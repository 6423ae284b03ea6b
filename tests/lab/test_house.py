"""`lab house`: its counts on a file that is known by heart, and the files that a call runs through."""

import tomllib
from pathlib import Path

from lab.figures.house import PARTS, house, traced
from optolever.patterns import sequence

SOURCE = '''"""Eight words, of which two are private: told, seen."""

from typing import Any

_LIMIT = 5.0
_NAMES = ("a", 1)
lower = 3


def wide(a: Any, b: int, c: int, d: int, e: int, f: int, g: int, h: int, i: int) -> None:
    pass  # whole


@kernel
def loop(a: Any, b: Any, c: Any, d: Any, e: Any, f: Any, g: Any, h: Any, i: Any) -> None:
    pass
'''


def test_counts_of_a_known_file(tmp_path: Path) -> None:
    (tmp_path / "part").mkdir()
    (tmp_path / "part/one.py").write_text(SOURCE)
    (tmp_path / "part/page.js").write_text("let a\nlet b\n")
    (tmp_path / "part/light.glsl").write_text("void main() {}\n")
    counts = house("part", tmp_path)
    assert (counts.files, counts.lines, counts.scripts) == (1, SOURCE.count("\n"), 3)
    assert (counts.any_parameters, counts.wide_functions, counts.constants) == (10, 1, 1)
    assert counts.private_words == 100 * 3 / 10


def test_every_installed_part_is_counted(root: Path) -> None:
    """The folders of pyproject.toml, down to their names."""
    tool = tomllib.loads((root / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["setuptools"]
    assert {Path(folder).parts[0] for folder in tool["package-dir"].values()} <= set(PARTS)


def test_a_call_touches_the_files_that_it_runs_through() -> None:
    files = traced(lambda: sequence("phase", 8, 8, periods=8.0).render())
    assert files
    assert {Path(name).parts[0] for name in files} == {"patterns"}
