"""The source in figures: lines and constants."""

import ast
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

__all__ = ["BESIDE", "PARTS", "ROOT", "House", "house", "total"]

ROOT = Path(__file__).resolve().parents[2]
#: Installed folders, and the lines of each at most; None: no limit of its own.
PARTS: dict[str, int | None] = {
    "optolever": 2050,
    "scene": 3000,
    "patterns": 1000,
    "projector": 6050,
    "decode": 5750,
    "contact": 1100,
    "reconstruct": 6500,
    "calibration": 2570,
    "metrology": 1830,
    "live": 3400,
    "cli": 5800,
    "formats": 350,
    "experiments": 3700,
}
INSTALLED = 38_000  # lines of all parts, at most
BESIDE = {"lab": 3720, "tests": 14_500}
_SCRIPTS = (".js", ".glsl")


@dataclass(frozen=True, slots=True)
class House:
    """Figures of one part; lines of Python, limit on them, scripts: lines of JavaScript and GLSL; constants:
    numbers with a name of their own at a module's top."""

    part: str
    files: int
    lines: int
    limit: int | None
    scripts: int
    constants: int


def house(part: str, root: Path = ROOT) -> House:
    """Figures of the part in folder `part` below `root`, the checkout."""
    paths = sorted((root / part).rglob("*.py"))
    return House(
        part=part,
        files=len(paths),
        lines=_lines(paths),
        limit=(PARTS | BESIDE).get(part),
        scripts=_lines(path for path in (root / part).rglob("*") if path.suffix in _SCRIPTS),
        constants=sum(_constants(node) for path in paths for node in ast.parse(path.read_bytes()).body),
    )


def total(rows: Iterable[House]) -> dict[str, int]:
    """Lines of the installed parts among these: all, and the limit on them."""
    return {"lines": sum(row.lines for row in rows if row.part in PARTS), "limit": INSTALLED}


def _lines(paths: Iterable[Path]) -> int:
    return sum(len(path.read_text(encoding="utf-8").splitlines()) for path in paths)


def _constants(node: ast.stmt) -> int:
    """How many names in capitals a statement gives to numbers, alone, in a tuple or in an expression."""
    if not isinstance(node, ast.Assign):
        return 0
    names, value = node.targets[0], node.value
    if isinstance(names, ast.Tuple):
        parts = value.elts if isinstance(value, ast.Tuple) else [value] * len(names.elts)
        return sum(_is_constant(name, part) for name, part in zip(names.elts, parts, strict=False))
    return int(_is_constant(names, value))


def _is_constant(name: ast.expr, value: ast.expr) -> bool:
    known = [one.value for one in ast.walk(value) if isinstance(one, ast.Constant)]
    numbers = [one for one in known if type(one) in (int, float)]
    return (
        isinstance(name, ast.Name)
        and name.id.isupper()
        and bool(numbers)
        and not any(isinstance(one, str) for one in known)
    )
