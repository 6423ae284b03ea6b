"""Public Numba only: an update of it must not take the decoder away."""

import re
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PARTS = sorted(path.parent.name for path in ROOT.glob("*/__init__.py"))
#: Modules of numba that its manual documents.
PUBLIC = "config|errors|extending|typed|types"
PRIVATE = re.compile(
    rf"^\s*(?:from|import)\s+numba\.(?!(?:{PUBLIC})\b)\w+"
    r"|^\s*from\s+numba\s+import\s.*\b(?:core|np|cpython|targets|misc|parfors|typing|pycc)\b"
    r"|\bllvmlite\b|\b_nrt\b|\bpipeline_class\b|\bnumba\.(?:core|np|cpython|targets)\b",
    re.MULTILINE,
)


def private_uses(path: Path) -> Iterator[str]:
    """Where a source names what belongs to numba alone."""
    text = path.read_text()
    for found in PRIVATE.finditer(text):
        yield f"{path.name}:{text.count(chr(10), 0, found.start()) + 1}: {found.group().strip()}"


@pytest.mark.parametrize("part", [*PARTS, "tests"])
def test_no_private_module_of_numba_is_used(part: str) -> None:
    files = [path for path in sorted((ROOT / part).rglob("*.py")) if path != Path(__file__)]
    assert files
    assert not [use for path in files for use in private_uses(path)]


@pytest.mark.parametrize(
    "line",
    [
        "from numba.core import types",
        "import numba.core.cgutils as cg",
        "    from numba.np import arrayobj",
        "from numba import njit, core",
        "import llvmlite.ir",
        "@njit(_nrt=False)",
        "@njit(pipeline_class=Own)",
        "kind = numba.core.types.Array",
    ],
)
def test_the_scan_finds_what_it_forbids(line: str, tmp_path: Path) -> None:
    path = tmp_path / "module.py"
    path.write_text(f"import numpy as np\n{line}\n")
    assert len(list(private_uses(path))) == 1
    path.write_text("import numba\nfrom numba import njit\nfrom numba.extending import overload\n")
    assert not list(private_uses(path))
