"""Groups of commands that load when they are called, listed in sections with full summaries."""

import importlib
from collections.abc import Mapping, Sequence
from typing import Any

import click

#: Commands by section of --help.
SECTIONS: Mapping[str, tuple[str, ...]] = {
    "Commands": (
        *("demo", "start", "doctor", "rig", "show", "simulate"),
        *("decode", "explain", "reconstruct", "calibrate", "report", "live", "design"),
    ),
    "Further commands": ("camera", "form", "export", "sample", "response"),
}
CAMERA = ("expose", "sync", "record", "replay", "measure")
#: Modules that are not named as their command.
MODULES = {"rig": "rig.new"} | {name: f"rig.{name}" for name in ("start", "expose", "sync")}


class Commands(click.Group):
    """A group whose commands are modules of a package, imported when they are asked for; sections: their
    names under headings."""

    def __init__(
        self, *args: Any, sections: Mapping[str, Sequence[str]], package: str = __package__, **given: Any
    ) -> None:
        super().__init__(*args, **given)
        self.sections, self.package = sections, package

    def list_commands(self, ctx: click.Context) -> list[str]:
        return [name for names in self.sections.values() for name in names]

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        if cmd_name not in self.list_commands(ctx):
            return None
        module = MODULES.get(cmd_name, cmd_name) if self.package == __package__ else cmd_name
        command = importlib.import_module(f"{self.package}.{module}").command
        assert isinstance(command, click.Command)
        return command

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        for heading, names in self.sections.items():
            rows = []
            for name in names:
                command = self.get_command(ctx, name)
                assert command is not None
                rows.append((name, command.get_short_help_str(limit=formatter.width)))
            with formatter.section(heading):
                formatter.write_dl(rows)
