"""What pages show runs: blocks of Python, commands and TOML files of a page, in order, in one folder.

A block behind `<!-- not run: REASON -->` is left out. A TOML block that begins with `# NAME.toml` is written.
"""

import contextlib
import io
import re
import shlex
import shutil
from dataclasses import dataclass
from itertools import product
from pathlib import Path

import pytest

from optolever.cli import run
from optolever.cli.commands import CAMERA, SECTIONS

ROOT = Path(__file__).resolve().parents[2]
#: Notices that are true of pages' captures, by their first words.
TRUE = (
    "pictures compressed with loss", "No capture reveals it", "z = 0 is the mirror", "The [layer] has no",
)  # fmt: skip
#: And of one page's: a press is solved with another one as its rest capture.
TRUE_OF = {
    "docs/howto/compare.md": ("Outside the contacts the mirror does", "Heights lie below those at rest")
}
PAGES = sorted(path.relative_to(ROOT).as_posix() for path in (ROOT / "docs").rglob("*.md"))
#: Pages that measure for seconds; the others are run every day.
SLOW = {
    "docs/howto/calibrate.md", "docs/howto/code.md", "docs/howto/compare.md", "docs/howto/facet.md",
    "docs/howto/live.md", "docs/howto/rest.md", "docs/rig/monitor.md", "docs/rig/prism.md",
}  # fmt: skip
#: Pages whose printed numbers are compared with those of the run.
PRINTED = {"docs/howto/facet.md", "docs/howto/rest.md"}
#: What the Python of a page prints.
SAYS = {"docs/howto/live.md": r"contact 1 at .* mm\n  0\.\d+ \+- 0\.\d+ mm, \d\.\d+ \+- \d\.\d+ N"}
NUMBER = re.compile(r"(?<![\w.,])-?\d+(?:\.\d+)?(?![\w,])")
BLOCK = re.compile(
    r"(<!-- not run: [^>]+ -->\n)?^```(python|console|toml)\n(.*?)^```", re.MULTILINE | re.DOTALL
)


#: What the commands at a page's beginning left, printed and said, by the commands: pages share samples.
BEGUN = dict[tuple[str, ...], tuple[Path, str, str]]()


@pytest.fixture(scope="module")
def kept(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("begun")


@dataclass(frozen=True)
class Block:
    language: str
    text: str


def blocks(text: str) -> list[Block]:
    return [Block(found[2], found[3]) for found in BLOCK.finditer(text) if not found[1]]


def play(page: str, text: str, kept: Path) -> str:
    """Run the blocks of a page in the working folder; what its Python prints. kept: folder of BEGUN."""
    names: dict[str, object] = {"__name__": "__page__"}
    printed_by_python = io.StringIO()
    begun: tuple[str, ...] = (str(kept),)
    for block in blocks(text):
        first = block.text.partition("\n")[0]
        begun = begun if block.language == "console" else ()
        if block.language == "python":
            with contextlib.redirect_stdout(printed_by_python):
                exec(compile(block.text, page, "exec"), names)
        elif block.language == "toml" and re.fullmatch(r"# [\w-]+\.toml", first):
            Path(first[2:]).write_text(block.text)
        elif block.language == "console":
            for line, shown in commands(block.text):
                begun = (*begun, line) if 0 < len(begun) < 5 else ()
                printed, said = ran(line, page, begun)
                true(said + printed, f"{page}: {line}")
                if page in PRINTED:
                    same(shown, printed, page)
    return printed_by_python.getvalue()


def ran(line: str, page: str, begun: tuple[str, ...]) -> tuple[str, str]:
    """What a command prints and says; of those with which a page begins, what they left for another page."""
    if begun in BEGUN:
        left, printed, said = BEGUN[begun]
        shutil.copytree(left, ".", dirs_exist_ok=True)
        return printed, said
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        assert run(shlex.split(line)[1:]) == 0, f"{page}: {line}"
    if begun:
        left = Path(begun[0]) / str(len(BEGUN))
        BEGUN[begun] = shutil.copytree(".", left), out.getvalue(), err.getvalue()
    return out.getvalue(), err.getvalue()


def true(printed: str, where: str) -> None:
    """Notices are true of the capture, and most of its pixels are good."""
    for notice in re.findall(r"[Nn]otice: (.*)", printed):
        assert notice.startswith(TRUE + TRUE_OF.get(where.partition(":")[0], ())), f"{where}: {notice}"
    for good in re.findall(r"^ *good +([\d.]+) %|([\d.]+) % good", printed, re.MULTILINE):
        assert float(max(good)) > 50, f"{where}: {max(good)} % good"


def commands(text: str) -> list[tuple[str, str]]:
    """Commands of a block, and the part of their output that it prints."""
    parts = re.split(r"^\$ (?=optolever )", text.replace("\\\n", " "), flags=re.MULTILINE)[1:]
    return [(head, shown) for head, _, shown in (part.partition("\n") for part in parts)]


def same(shown: str, printed: str, page: str) -> None:
    """Lines of the same beginning have the same numbers within 20 % of the line's largest."""
    lines = dict(
        re.split(r"  +", line.strip(), maxsplit=1) for line in printed.splitlines() if "  " in line.strip()
    )
    for line in shown.splitlines():
        name, _, rest = line.strip().partition("  ")
        if not rest or "×" in rest:
            continue
        assert name in lines, f"{page}: {line} is not printed"
        old, new = (
            [float(one) for one in NUMBER.findall(text.replace("−", "-"))] for text in (rest, lines[name])
        )
        assert new[: len(old)] == pytest.approx(old, rel=0.2, abs=0.01 * max(map(abs, old), default=0)), line


@pytest.mark.parametrize(
    "page", [pytest.param(page, marks=pytest.mark.slow if page in SLOW else ()) for page in PAGES]
)
def test_page_runs(page: str, kept: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert re.search(SAYS.get(page, ""), play(page, (ROOT / page).read_text(), kept))


def test_every_code_block_names_its_language() -> None:
    """Else it would be neither run nor checked."""
    for page in PAGES:
        fences = re.findall(r"^```(\S*)", (ROOT / page).read_text(), re.MULTILINE)[::2]
        assert set(fences) <= {"python", "console", "toml", "{toctree}", "{eval-rst}"}, page


def test_commands_and_parts_have_their_lines() -> None:
    """The commands of --help, and the faces of the installed parts."""
    table = re.findall(
        r"^\| `optolever ([\w ]+)`", (ROOT / "docs/reference/cli.md").read_text(), re.MULTILINE
    )
    groups = {"camera": CAMERA, "rig": ("new",)}
    names = [name for names in SECTIONS.values() for name in names]
    assert table == [
        " ".join(one).strip() for name in names for one in product([name], groups.get(name, [""]))
    ]
    sections = re.findall(
        r"^## optolever\.(\w+)$", (ROOT / "docs/reference/api.md").read_text(), re.MULTILINE
    )
    inside = {"optolever", "cli", "lab", "tests"}
    assert set(sections) == {path.parent.name for path in ROOT.glob("*/__init__.py")} - inside


def test_architecture_names_files_that_exist() -> None:
    text = (ROOT / "docs/architecture.md").read_text()
    parts = [path for path in ROOT.iterdir() if (path / "__init__.py").is_file() and path.name != "tests"]
    names = {
        one.relative_to(part.parent).as_posix() + "/" * one.is_dir()
        for part in parts
        for one in part.rglob("*")
    }
    for name in re.findall(r"`([\w/]+(?:\.py|/))`", text):
        assert any(
            f"/{one}".endswith(f"/{name}") for one in (*names, *(f"{part.name}/" for part in parts))
        ), name
