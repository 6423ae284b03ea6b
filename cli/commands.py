"""Groups of commands that load when they are called, listed in sections, every summary whole."""

import importlib
from collections.abc import Mapping, Sequence

import click

__all__ = ["LAB", "SECTIONS", "Commands", "Laboratory", "Program", "module_of"]

#: What a user calls, by section of --help.
SECTIONS: Mapping[str, tuple[str, ...]] = {
    "Start": ("demo", "doctor", "names"),
    "Measure": ("show", "capture", "decode", "calibrate", "rest", "response", "reconstruct", "report"),
    "Plan and compare": ("design", "bench", "paper", "lab"),
}
#: What measures and attacks the program itself: optolever lab NAME.
LAB: Mapping[str, tuple[str, ...]] = {
    "Figures": ("figures", "methods", "codes", "sweep", "calibration"),
    "Attacks": ("hard", "fuzz"),
    "Design": ("choices", "sensor", "adapt"),
}
#: Files that are not named as their command.
MODULES = {"show": "window", "calibration": "rigs"}


def module_of(name: str) -> str:
    """The file beside this one that holds a command."""
    return MODULES.get(name, name)


class Commands(click.Group):
    """A group whose commands are modules beside this one, imported when they are asked for.

    sections: names under their headings. aliases: other names that work and are not listed.
    """

    sections: Mapping[str, Sequence[str]] = {}
    aliases: Sequence[str] = ()

    def list_commands(self, ctx: click.Context) -> list[str]:
        return [name for names in self.sections.values() for name in names]

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        if cmd_name not in (*self.list_commands(ctx), *self.aliases):
            return None
        command = importlib.import_module(f".{module_of(cmd_name)}", __package__).command
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


class Program(Commands):
    """optolever NAME; the laboratory's commands answer to their old names, too."""

    sections = SECTIONS
    aliases = tuple(name for names in LAB.values() for name in names if name not in ("fuzz", "calibration"))


class Laboratory(Commands):
    """optolever lab NAME."""

    sections = LAB
