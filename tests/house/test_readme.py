"""README and pages say nothing that no command backs: commands, options, links and figures exist."""

import re
import shlex
from pathlib import Path
from textwrap import dedent

import click
import cv2
import pytest

from lab.program import NAME, lab
from optolever.cli.app import app

from ..docs.test_advice import COMMANDS

TARGET = re.compile(r"^([a-z-]+):", re.MULTILINE)


def pages(root: Path) -> list[Path]:
    """README and all pages of the documentation."""
    return [root / "README.md", *sorted((root / "docs").rglob("*.md"))]


def command_lines(page: Path) -> list[str]:
    """Calls of make, optolever and the laboratory on a page, continuation lines joined."""
    text = page.read_text()
    blocks = re.findall(r"^```[a-z]*\n(.*?)^```", text, re.MULTILINE | re.DOTALL)
    lines = "".join(blocks).replace("\\\n", " ").splitlines()
    bare = [re.sub(r"^\$ ", "", line).split("#")[0].strip() for line in lines]
    inline = re.findall(r"`((?:make|optolever|python -m lab) [^`]+)`", text)
    return [line for line in [*bare, *inline] if re.match(r"(make|optolever|python -m lab)\b", line)]


def test_the_readme_is_short_and_begins_with_two_commands(root: Path) -> None:
    lines = command_lines(root / "README.md")
    assert lines[:2] == ["make demo", "make test"]
    assert len((root / "README.md").read_text().splitlines()) <= 150


def test_make_targets_exist(root: Path) -> None:
    targets = set(TARGET.findall((root / "Makefile").read_text()))
    lines = [line for page in pages(root) for line in command_lines(page)]
    named = {word for line in lines if line.startswith("make ") for word in line.split()[1:]}
    assert named
    assert not named - targets


def test_programs_lines_parse(root: Path) -> None:
    """Each line of a page or a sample names a command and options that exist."""
    lines = [(page.name, line) for page in pages(root) for line in command_lines(page)]
    for name, command in COMMANDS.items():
        sample = dedent((command.epilog or "").partition("Sample:\n")[2]).replace("\\\n", " ")
        lines += [(name, line[2:]) for line in sample.splitlines() if line.startswith("$ ")]
    programs = {"optolever ": app, f"{NAME} ": lab}
    calls = [
        (page, program, shlex.split(line.removeprefix(start)))
        for page, line in lines
        for start, program in programs.items()
        if line.startswith(start)
    ]
    assert {program.name for _, program, _ in calls} == {"app", "lab"}
    for page, program, (name, *args) in calls:
        if name.startswith("--"):
            continue
        command = program.get_command(click.Context(program), name)
        if isinstance(command, click.Group) and args and not args[0].startswith("--"):
            name, *args = args
            command = command.get_command(click.Context(command), name)
        assert command is not None, f"{page}: {name} {args}"
        known = {option for parameter in command.params for option in parameter.opts} | {"--help"}
        unknown = [arg for arg in args if arg.startswith("--") and arg not in known]
        assert not unknown, f"{page}: {name} {args}: {unknown}"


def test_files_that_texts_point_at_exist(root: Path) -> None:
    for page in (*pages(root), root / "CONTRIBUTING.md"):
        linked = re.findall(r"\]\((?!https?:)([^)#\s]+)(?:#[^)]*)?\)", page.read_text())
        figures = [link for link in linked if "_figures/" in link]  # drawn when the pages are built
        missing = [link for link in linked if link not in figures and not (page.parent / link).exists()]
        assert not missing, f"{page.name}: {missing}"


def test_the_python_sample_runs(root: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As printed."""
    (code,) = re.findall(r"^```python\n(.*?)^```", (root / "README.md").read_text(), re.MULTILINE | re.DOTALL)
    monkeypatch.chdir(tmp_path)
    exec(code, {})
    assert cv2.imread(str(tmp_path / "height.png")) is not None
