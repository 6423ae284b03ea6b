"""The architecture: imports run downward, across parts through the face, never bare.

The laboratory (`lab/`) stands beside the tests: it may import every module of every part; no part imports it.
"""

import ast
import importlib
from collections.abc import Iterator
from graphlib import TopologicalSorter
from pathlib import Path

import pytest

FLOOR = {
    "optolever": 0,
    "patterns": 1,
    "scene": 1,
    "contact": 2,
    "decode": 2,
    "projector": 2,
    "camera": 3,
    "reconstruct": 3,
    "calibration": 4,
    "formats": 4,
    "metrology": 4,
    "live": 4,
    "samples": 5,
    "design": 6,
    "report": 6,
    "cli": 7,
}
PARTS = [part for part in FLOOR if part != "optolever"]
ROOT = Path(__file__).resolve().parents[2]
INNER = sorted(str(p.parent.relative_to(ROOT)) for part in PARTS for p in (ROOT / part).glob("*/__init__.py"))


def imports(path: Path) -> Iterator[tuple[int, int, str, list[str]]]:
    """(line, level, module, names) of every import statement in a file, wherever it stands."""
    for node in ast.walk(ast.parse(path.read_text(), str(path))):
        if isinstance(node, ast.Import):
            for alias in node.names:
                yield node.lineno, 0, alias.name, []
        elif isinstance(node, ast.ImportFrom):
            yield node.lineno, node.level, node.module or "", [alias.name for alias in node.names]


def faults(path: Path, part: str, depth: int) -> Iterator[str]:
    """What is wrong with the imports of a file that lies `depth` folders inside `part`."""
    for line, level, module, names in imports(path):
        where = f"{path.relative_to(ROOT)}:{line}"
        head, _, rest = module.partition(".")
        if level > 0:
            if level > depth + 1:
                yield f"{where}: a relative import leaves {part}/"
        elif head == "lab":
            yield f"{where}: the laboratory is not installed, tests alone import it"
        elif head in PARTS:
            yield f"{where}: bare import of {module}; say optolever.{module}"
        elif head == "optolever":
            targets = [rest] if rest else [name for name in names if name in PARTS]
            for target in targets:
                top, _, inner = target.partition(".")
                if top not in PARTS:
                    continue
                if top == part:
                    yield f"{where}: {part}/ imports itself by its full name; use a relative import"
                elif inner and not (ROOT / top / inner.replace(".", "/") / "__init__.py").is_file():
                    yield f"{where}: optolever.{target} reaches behind the face of {top}/"
                elif FLOOR[top] >= FLOOR[part] and path != ROOT / "optolever/__init__.py":  # names the parts
                    yield f"{where}: {part}/ on floor {FLOOR[part]} imports upward: {top}/ on {FLOOR[top]}"


@pytest.mark.parametrize("part", FLOOR)
def test_imports_run_downward_and_through_faces(part: str) -> None:
    files = sorted((ROOT / part).rglob("*.py"))
    assert files
    found = [
        fault for path in files for fault in faults(path, part, len(path.relative_to(ROOT / part).parts) - 1)
    ]
    assert not found, "\n".join(found)


@pytest.mark.parametrize("folder", ["tests", "lab"])
def test_tests_and_laboratory_use_the_installed_name(folder: str) -> None:
    """`import patterns` from the repository's root would load a second copy of the part."""
    found = [
        f"{path.relative_to(ROOT)}:{line}: {module}"
        for path in sorted((ROOT / folder).rglob("*.py"))
        for line, level, module, _ in imports(path)
        if level == 0 and module.partition(".")[0] in PARTS
    ]
    assert not found, "\n".join(found)


@pytest.mark.parametrize("part", [*PARTS, *INNER])
def test_faces_have_a_map_and_a_complete_all(part: str) -> None:
    face = importlib.import_module(f"optolever.{part.replace('/', '.')}")
    assert face.__doc__
    assert face.__all__ == sorted(set(face.__all__), key=face.__all__.index), "a name stands twice"
    missing = [name for name in face.__all__ if not hasattr(face, name)]
    assert not missing
    unmapped = [
        path.stem
        for path in (ROOT / part).glob("*.py")
        if path.stem != "__init__" and path.stem.lstrip("_") not in face.__doc__
    ]
    assert not unmapped, f"the docstring of {part}/__init__.py does not name {unmapped}"


def test_the_laboratory_has_a_map() -> None:
    files = [path for path in (ROOT / "lab").rglob("*.py") if path.parent.name != "commands"]
    text = importlib.import_module("lab").__doc__ or ""
    unmapped = [path for path in files if not path.stem.startswith("__") and f"`{path.name}`" not in text]
    assert not unmapped, f"the docstring of lab/__init__.py does not name {unmapped}"


def graph(folder: Path) -> dict[str, set[str]]:
    """file -> files of the same part that it imports from, wherever the statement stands, also for types."""
    paths = {path.relative_to(folder).with_suffix("").as_posix(): path for path in folder.rglob("*.py")}
    found: dict[str, set[str]] = {}
    for name, path in paths.items():
        targets = set()
        for _, level, module, names in imports(path):
            if level:
                base = path.relative_to(folder).parts[: -level or None]
                places = [module.split(".")] if module else [[each] for each in names]
                targets |= {"/".join((*base, *place)) for place in places}
        found[name] = {f"{each}/__init__" if each not in paths else each for each in targets} & paths.keys()
    return found


@pytest.mark.parametrize("part", [*FLOOR, "lab"])
def test_no_import_leads_back(part: str) -> None:
    TopologicalSorter(graph(ROOT / part)).prepare()  # CycleError names the files
