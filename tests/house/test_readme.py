"""No sentence of the README that no command backs: its commands exist, with the options it gives them."""

import re
import shlex
from pathlib import Path

import click
import pytest

from optolever.cli.app import app

TARGET = re.compile(r"^([a-z-]+):", re.MULTILINE)


def command_lines(root: Path) -> list[str]:
    """Lines of the README's code blocks that call make or optolever, continuation lines joined."""
    text = (root / "README.md").read_text()
    blocks = re.findall(r"^```[a-z]*\n(.*?)^```", text, re.MULTILINE | re.DOTALL)
    lines = "".join(blocks).replace("\\\n", " ").splitlines()
    bare = [re.sub(r"^\$ ", "", line).split("#")[0].strip() for line in lines]
    inline = re.findall(r"`((?:make|optolever) [^`]+)`", text)
    return [line for line in [*bare, *inline] if re.match(r"(make|optolever)\b", line)]


def test_the_two_commands_come_first(root: Path) -> None:
    lines = command_lines(root)
    assert lines[:2] == ["make demo", "make test"]


def test_make_targets_exist(root: Path) -> None:
    targets = set(TARGET.findall((root / "Makefile").read_text()))
    named = {word for line in command_lines(root) if line.startswith("make ") for word in line.split()[1:]}
    assert named
    assert not named - targets


def test_programs_lines_parse(root: Path) -> None:
    """Each line names a command and options that exist; `a | b` lists are names of commands."""
    lines = [line for line in command_lines(root) if line.startswith("optolever ")]
    assert len(lines) >= 4
    for line in lines:
        name, *args = shlex.split(line)[1:]
        command = app.get_command(click.Context(app), name)
        if isinstance(command, click.Group):
            command = command.get_command(click.Context(command), args.pop(0))
        assert command is not None, line
        known = {option for parameter in command.params for option in parameter.opts} | {"--help"}
        unknown = [arg for arg in args if arg.startswith("--") and arg not in known]
        assert not unknown, f"{line}: {unknown}"


def test_files_that_texts_point_at_exist(root: Path) -> None:
    for name in ("README.md", "CONTRIBUTING.md"):
        text = (root / name).read_text()
        linked = re.findall(r"\]\((?!https?:)([^)#]+)\)", text)
        missing = [link for link in linked if not (root / link).exists()]
        assert not missing, f"{name}: {missing}"


def test_ci_runs_what_the_readme_says(root: Path) -> None:
    script = (root / ".ci/run").read_text()
    steps = re.findall(r"^make (\S+) \|\| status=1$", script, re.MULTILINE)
    assert steps == ["lint", "typecheck", "test", "test-slow"]
    assert script.endswith('exit "$status"\n')
    if not (root / ".ci/run").stat().st_mode & 0o100:
        pytest.fail(".ci/run is not executable")


def test_the_python_sample_runs(root: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As printed, on a smaller camera."""
    (code,) = re.findall(r"^```python\n(.*?)^```", (root / "README.md").read_text(), re.MULTILINE | re.DOTALL)
    whole = 'scene.load("paper-simulation")'
    assert whole in code
    monkeypatch.chdir(tmp_path)
    exec(code.replace(whole, f"scene.resize({whole}, 64, 64)"), {})
    assert (tmp_path / "h.npz").is_file()


def test_no_reader_of_x3p_is_promised(root: Path) -> None:
    """There is a writer and no reader: wherever the format is offered, that is said."""
    assert "X3P and PLY are only written, never read" in " ".join((root / "README.md").read_text().split())
    option = next(
        option
        for option in app.get_command(click.Context(app), "reconstruct").params  # type: ignore[union-attr]
        if "--grid" in option.opts
    )
    assert "only written, never read" in str(option.help)  # type: ignore[attr-defined]
