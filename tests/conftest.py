"""What every test folder shares: the repository, `lab`, real captures, commands that are refused."""

import importlib.util
import re
import sys
import tomllib
from collections import defaultdict
from collections.abc import Callable, Iterable
from pathlib import Path

import pytest

from optolever.cli import run

ROOT = Path(__file__).resolve().parents[1]
#: Figures that the decoder is known to miss, with reasons.
_MISSED = Path(__file__).with_name("missed_figures.toml")


def _import_lab() -> None:
    """Make `import lab` find the laboratory, which is not installed.

    With the root itself on the path `import patterns` would find a second copy of a part.
    """
    spec = importlib.util.spec_from_file_location("lab", ROOT / "lab" / "__init__.py")
    assert spec is not None
    assert spec.loader is not None
    sys.modules["lab"] = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(sys.modules["lab"])


_import_lab()


@pytest.fixture(scope="session")
def root() -> Path:
    """The repository's root."""
    return ROOT


@pytest.fixture(scope="session")
def real() -> Path:
    """../shared/real, the captures by real cameras that are kept beside the repository."""
    folder = ROOT.parent / "shared" / "real"
    if not folder.is_dir():
        pytest.skip(f"{folder} is absent: no real captures to test with")
    return folder


@pytest.fixture
def refused(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> Callable[..., str]:
    """Function that runs a command (of `optolever`, or through another `run`) which must end with 2 and one
    line that holds all words, and gives that line; nothing changes in a folder.
    """

    def held(folder: Path) -> dict[Path, bytes]:
        return {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}

    def told(
        args: Iterable[object],
        *words: object,
        folder: Path = tmp_path,
        run: Callable[[list[str]], int] = run,
    ) -> str:
        before = held(folder)
        capfd.readouterr()
        code, streams = run([str(arg) for arg in args]), capfd.readouterr()
        assert (code, streams.out) == (2, "")
        (line,) = streams.err.splitlines()
        assert re.match("(optolever|python -m lab): ", line)
        for word in words:
            assert str(word) in line, f"{word!r} not in: {line}"
        assert held(folder) == before
        return line

    return told


def _mark_rare_cases(items: list[pytest.Item]) -> None:
    """`daily(n)`: n cases of a family, spread evenly from its first to its last, run every day; the others
    are slow.
    """
    families: defaultdict[str, list[pytest.Item]] = defaultdict(list)
    for item in items:
        if item.get_closest_marker("daily"):
            families[item.nodeid.partition("[")[0]].append(item)
    for cases in families.values():
        (count,) = cases[0].get_closest_marker("daily").args
        kept = {round(k * (len(cases) - 1) / max(count - 1, 1)) for k in range(count)}
        for item in (case for i, case in enumerate(cases) if i not in kept):
            item.add_marker(pytest.mark.slow)


@pytest.hookimpl(tryfirst=True)  # before slow ones are left out
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark listed tests as expected to fail, and slow, as they protect nothing. One that passes is told
    (XPASS) and goes from the list. Rare cases of families are slow, too. Files with slow tests come first:
    short ones leave no processor idle at the end.
    """
    _mark_rare_cases(items)
    missed = tomllib.loads(_MISSED.read_text(encoding="utf-8"))
    for item in items:
        for group in missed["missed"]:
            if any(item.nodeid.startswith(prefix) for prefix in group["tests"]):
                item.add_marker(pytest.mark.xfail(reason=group["reason"], strict=False))
                item.add_marker(pytest.mark.slow)
    long = {item.path for item in items if item.get_closest_marker("slow")}
    items.sort(key=lambda item: item.path not in long)
