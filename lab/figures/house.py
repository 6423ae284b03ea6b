"""The source in figures beside the limits of house.toml: code lines by part, ratchets that only fall."""

import ast
import io
import tokenize
import tomllib
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from datetime import date
from pathlib import Path

import click

from optolever.cli.app import app
from optolever.files import atomic_file
from optolever.toml import toml_text

__all__ = ["BESIDE", "PARTS", "ROOT", "House", "accept", "code_lines", "house", "limits", "over", "ratchets"]

ROOT = Path(__file__).resolve().parents[2]
#: Installed folders; folders beside them.
PARTS = (
    *("optolever", "scene", "patterns", "projector", "decode", "contact", "reconstruct", "calibration"),
    *("camera", "metrology", "live", "cli", "formats", "samples", "report", "design"),
)
BESIDE = ("lab", "tests")
_LONG, _COMPLEX = 90, 30  # lines of a function, branches
_SCRIPTS = (".js", ".glsl")
_LAYOUT = {
    tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT, tokenize.ENDMARKER
}  # fmt: skip
_LOOPS = ast.If | ast.IfExp | ast.For | ast.While | ast.ExceptHandler | ast.comprehension | ast.match_case


@dataclass(frozen=True, slots=True)
class House:
    """Figures of one part: lines of code (no blanks, comments, docstrings, imports), lines of JavaScript and
    GLSL."""

    part: str
    files: int
    code: int
    scripts: int


def house(part: str, root: Path = ROOT) -> House:
    """Figures of the part in folder `part` below `root`, the checkout."""
    paths = _sources([part], root)
    scripts = [path for path in (root / part).rglob("*") if path.suffix in _SCRIPTS]
    return House(
        part,
        len(paths),
        sum(code_lines(path.read_text(encoding="utf-8")) for path in paths),
        sum(len(path.read_text(encoding="utf-8").splitlines()) for path in scripts),
    )


def code_lines(text: str) -> int:
    """Lines of a module without blanks, comments, docstrings and imports."""
    kept: set[int] = set()
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type not in _LAYOUT:
            kept |= {*range(token.start[0], token.end[0] + 1)}
    for node in ast.walk(ast.parse(text)):
        kept -= set(_lines_without_code(node))
    return len(kept)


def ratchets(root: Path = ROOT) -> dict[str, int]:
    """Numbers that may only fall: of the installed parts functions of more than 90 lines or 30 branches,
    named numbers and file names that occur again; commands and options of the largest; tests that are
    expected to fail."""
    trees = {path: ast.parse(path.read_bytes()) for path in _sources(PARTS, root)}
    functions = [
        node for tree in trees.values() for node in ast.walk(tree) if isinstance(node, ast.FunctionDef)
    ]
    names = Counter(path.name for path in trees if path.stem != "__init__")
    missed = tomllib.loads((root / "tests/missed_figures.toml").read_text(encoding="utf-8"))
    return {
        "long_functions": sum(_is_long(node) for node in functions),
        "named_numbers": sum(_numbers(node) for tree in trees.values() for node in tree.body),
        "repeated_file_names": sum(count - 1 for count in names.values()),
        "commands": len(options := _options(app)),
        "options": max(options),
        "expected_failures": sum(len(group["tests"]) for group in missed.get("missed", [])),
    }


def limits(root: Path = ROOT) -> dict[str, int]:
    """Limits of parts, of `installed` and of ratchets, by name."""
    table = tomllib.loads((root / "house.toml").read_text(encoding="utf-8"))
    return {"installed": table["installed"], **table["parts"], **table["ratchets"]}


def over(found: dict[str, int], limit: dict[str, int]) -> dict[str, int]:
    """Excess over the limits, of the numbers with one; a number without a limit exceeds 0."""
    return {name: count - limit.get(name, 0) for name, count in found.items() if count > limit.get(name, 0)}


def accept(reason: str, rows: Iterable[House], now: dict[str, int], root: Path = ROOT) -> None:
    """Write today's code lines as limits, with reason and date; ratchets fall, and never rise."""
    parts, before = {row.part: row.code for row in rows}, limits(root)
    tables = {
        "parts": parts,
        "ratchets": {name: min(count, before.get(name, count)) for name, count in now.items()},
    }
    head = {"reason": reason, "date": date.today(), "installed": sum(parts.get(part, 0) for part in PARTS)}
    with atomic_file(root / "house.toml") as temporary:
        temporary.write_text(toml_text(head | tables), encoding="utf-8")


def _sources(parts: Iterable[str], root: Path) -> list[Path]:
    return sorted(path for part in parts for path in (root / part).rglob("*.py"))


def _lines_without_code(node: ast.AST) -> Iterator[int]:
    """Of an import, and of the docstring of a module, class or function."""
    if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
        if ast.get_docstring(node, clean=False) is None:
            return
        node = node.body[0]
    elif not isinstance(node, ast.Import | ast.ImportFrom):
        return
    yield from range(node.lineno, (node.end_lineno or node.lineno) + 1)


def _is_long(function: ast.FunctionDef) -> bool:
    """Whether it has more than 90 lines, or more than 30 branches (McCabe's number)."""
    inside = [*ast.walk(function)]
    branches = 1 + sum(isinstance(node, _LOOPS) for node in inside)
    branches += sum(len(node.values) - 1 for node in inside if isinstance(node, ast.BoolOp))
    return branches > _COMPLEX or (function.end_lineno or 0) - function.lineno >= _LONG


def _options(command: click.Command | None) -> list[int]:
    """How many options each command has, without --help."""
    assert command is not None
    if not isinstance(command, click.Group):
        return [sum(isinstance(each, click.Option) for each in command.params)]
    with click.Context(command) as context:
        below = [command.get_command(context, name) for name in command.list_commands(context)]
    return [count for one in below for count in _options(one)]


def _numbers(node: ast.stmt) -> int:
    """How many numbers a statement names in capitals: alone, in a tuple or in an expression, with a type or
    without."""
    if not isinstance(node, ast.Assign | ast.AnnAssign):
        return 0
    names: ast.expr = node.targets[0] if isinstance(node, ast.Assign) else node.target
    value = node.value
    if isinstance(names, ast.Tuple):
        parts = value.elts if isinstance(value, ast.Tuple) else [value] * len(names.elts)
        return sum(_count(name, part) for name, part in zip(names.elts, parts, strict=False))
    return _count(names, value)


def _count(name: ast.expr, value: ast.expr | None) -> int:
    """Of a name in capitals: its numbers, of a tuple each; 1 of any expression."""
    if value is None or not isinstance(name, ast.Name) or not name.id.isupper():
        return 0
    known = [one.value for one in ast.walk(value) if isinstance(one, ast.Constant)]
    numbers = sum(type(one) in (int, float) for one in known)
    if any(isinstance(one, str) for one in known):
        return 0
    return numbers if isinstance(value, ast.Tuple) else min(numbers, 1)
