"""Every option that a message advises is one of the command that it is advised for."""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import click
import pytest

from optolever.cli.app import app
from optolever.cli.commands import MODULES

ROOT = Path(__file__).resolve().parents[2]
PARTS = (
    "scene", "patterns", "projector", "camera", "decode", "reconstruct", "calibration", "metrology",
    "formats", "live",
)  # fmt: skip
FLAG = re.compile(r"(?<![\w-])--[a-z][a-z-]*")


def _commands(group: click.Group, of: str = "") -> Iterator[tuple[str, click.Command]]:
    context = click.Context(group)
    for name in group.list_commands(context):
        command = group.get_command(context, name)
        assert command is not None
        if isinstance(command, click.Group):
            yield from _commands(command, name)
        yield f"{of} {name}".strip(), command


COMMANDS = dict(_commands(app))
FLAGS = {
    name: {flag for parameter in command.params for flag in (*parameter.opts, *parameter.secondary_opts)}
    | {"--help"}
    for name, command in COMMANDS.items()
}
#: Of the commands that open a rig's devices.
OF_A_RIG = {"--set"}
#: Of other programs.
OTHERS = {"--shm-size"}
#: A command's name as a word: "camera sync", else "sync".
WORD = re.compile(
    rf"\b({'|'.join(sorted({*COMMANDS, *(name.split()[-1] for name in COMMANDS)}, key=len, reverse=True))})\b"
)


def wrong(text: str, own: set[str]) -> list[str]:
    """Flags of a text that neither `own` nor a command named before them has."""
    known, found = own | OTHERS, list[str]()
    for part in re.finditer(rf"{WORD.pattern}|{FLAG.pattern}", text):
        word = part[0]
        if word.startswith("--"):
            found += [] if word in known else [word]
        else:
            named = [name for name in COMMANDS if name == word or name.split()[-1] == word]
            known |= set().union(*(FLAGS[name] for name in named))
    return found


def messages(path: Path) -> Iterator[str]:
    """Strings of a file, f-strings with {} for their values; docstrings are not among them."""
    tree = ast.parse(path.read_text())
    skipped = {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr)}
    skipped |= {
        id(part) for node in ast.walk(tree) if isinstance(node, ast.JoinedStr) for part in node.values
    }
    for node in ast.walk(tree):
        if isinstance(node, ast.JoinedStr):
            yield "".join(str(part.value) if isinstance(part, ast.Constant) else "{}" for part in node.values)
        elif isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in skipped:
            yield node.value


@pytest.mark.parametrize("part", PARTS)
def test_messages_name_the_command_of_an_option(part: str) -> None:
    found = {
        f"{path.relative_to(ROOT)}: {flag} in {text!r}"
        for path in (ROOT / part).rglob("*.py")
        for text in messages(path)
        if " " in text and not text.startswith("--")
        for flag in wrong(text, OF_A_RIG if part == "camera" else set())
    }
    assert not found


def test_messages_of_a_command_name_its_own_options() -> None:
    modules: dict[str, set[str]] = {}
    for name, flags in FLAGS.items():
        for word in name.split():
            modules.setdefault(MODULES.get(word, word).rpartition(".")[2], set()).update(flags)
    every = set().union(*FLAGS.values())
    found = {
        f"{path.name}: {flag} in {text!r}"
        for path in (ROOT / "cli").rglob("*.py")
        for text in messages(path)
        if " " in text and not text.startswith("--")
        for flag in wrong(text, modules.get(path.stem, every))
    }
    assert not found
