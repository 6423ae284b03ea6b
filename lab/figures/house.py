"""The source in figures: lines, private words, parameters without a type, constants."""

import ast
import re
import tokenize
from collections.abc import Iterable, Iterator
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
    "calibration": 2600,
    "metrology": 1830,
    "live": 3400,
    "cli": 5800,
    "formats": 350,
    "experiments": 3710,
}
INSTALLED = 38_000  # lines of all parts, at most
BESIDE = {"lab": 4500, "tests": 14_500}
_SCRIPTS = (".js", ".glsl")
#: Words of the project's own dialect where the field has a noun (STYLE.md).
PRIVATE = re.compile(
    r"\b(told|tells?|seen|shown|left|own|usual|wanted|whole|beside|unlike|alike|few|held|spoilt)\b", re.I
)
WORD = re.compile(r"[A-Za-z]{2,}")
MOST_PARAMETERS = 8
KERNELS = {"kernel", "exact", "inlined"}


@dataclass(frozen=True, slots=True)
class House:
    """Figures of one part; lines of Python, limit on them, scripts: lines of JavaScript and GLSL.

    private_words per 100 of docstrings and comments; any_parameters annotated `Any`, wide_functions of more
    than 8 parameters and outside kernels; constants: numbers with a name of their own at a module's top.
    """

    part: str
    files: int
    lines: int
    limit: int | None
    scripts: int
    private_words: float
    any_parameters: int
    wide_functions: int
    constants: int


def house(part: str, root: Path = ROOT) -> House:
    """Figures of the part in folder `part` below `root`, the checkout."""
    paths = sorted((root / part).rglob("*.py"))
    trees = [ast.parse(path.read_bytes()) for path in paths]
    prose = [text for path, tree in zip(paths, trees, strict=True) for text in _prose(path, tree)]
    words = sum(len(WORD.findall(text)) for text in prose)
    private = sum(len(PRIVATE.findall(text)) for text in prose)
    functions = [node for tree in trees for node in ast.walk(tree) if isinstance(node, ast.FunctionDef)]
    return House(
        part=part,
        files=len(paths),
        lines=_lines(paths),
        limit=(PARTS | BESIDE).get(part),
        scripts=_lines(path for path in (root / part).rglob("*") if path.suffix in _SCRIPTS),
        private_words=100 * private / max(words, 1),
        any_parameters=sum(_is_any(one) for node in functions for one in _parameters(node)),
        wide_functions=sum(
            len(_parameters(one)) > MOST_PARAMETERS and not _is_kernel(one) for one in functions
        ),
        constants=sum(_constants(node) for tree in trees for node in tree.body),
    )


def total(rows: Iterable[House]) -> dict[str, int]:
    """Lines of the installed parts among these: all, and the limit on them."""
    return {"lines": sum(row.lines for row in rows if row.part in PARTS), "limit": INSTALLED}


def _lines(paths: Iterable[Path]) -> int:
    return sum(len(path.read_text(encoding="utf-8").splitlines()) for path in paths)


def _prose(path: Path, tree: ast.Module) -> Iterator[str]:
    """Docstrings and comments of a file."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef):
            yield ast.get_docstring(node) or ""
    with path.open("rb") as file:
        yield from (one.string for one in tokenize.tokenize(file.readline) if one.type == tokenize.COMMENT)


def _parameters(node: ast.FunctionDef) -> list[ast.arg]:
    return [*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs]


def _is_any(parameter: ast.arg) -> bool:
    return isinstance(parameter.annotation, ast.Name) and parameter.annotation.id == "Any"


def _is_kernel(node: ast.FunctionDef) -> bool:
    return any(isinstance(one, ast.Name) and one.id in KERNELS for one in node.decorator_list)


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
