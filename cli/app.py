"""The program `optolever`: commands that load when called, and the one place where errors become exit codes.

0: done. 2: the input cannot be used (one line on stderr says what, where, and the limit). 130: Ctrl-C.
"""

import importlib
import sys
from collections.abc import Sequence

import click

from optolever import InputError, __version__

__all__ = ["app", "main", "run"]

COMMANDS = (
    "demo",
    "capture",
    "decode",
    "calibrate",
    "reconstruct",
    "paper",
    "figures",
    "methods",
    "bench",
    "sweep",
    "hard",
    "design",
    "choices",
    "codes",
    "sensor",
    "adapt",
    "show",
    "names",
    "doctor",
    "lab",
)


MODULES = {"show": "window"}  # files that are not named as their command


class _Lazy(click.Group):
    """A group whose commands are modules beside this one, imported when they are asked for."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        if cmd_name not in COMMANDS:
            return None
        module = MODULES.get(cmd_name, cmd_name)
        command = importlib.import_module(f".{module}", __package__).command
        assert isinstance(command, click.Command)
        return command


@click.group(
    cls=_Lazy,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
    epilog="Start with: optolever demo --out out/demo",
)
@click.version_option(__version__, prog_name="optolever")
def app() -> None:
    """Patterns on a surface, a mirror that deforms, a camera: from the frames the height of the mirror.

    The chain is capture -> decode -> reconstruct; demo runs it whole and writes a report.
    """


def run(args: Sequence[str] | None = None) -> int:
    """Run the program on `args` (default: the process's); its exit code. Bad input never raises."""
    try:
        code = app.main(args=args, prog_name="optolever", standalone_mode=False)
    except InputError as error:
        return _complain(str(error))
    except click.ClickException as error:
        context = getattr(error, "ctx", None)
        hint = f" (see {context.command_path} --help)" if context is not None else ""
        return _complain(f"{error.format_message()}{hint}")
    except OSError as error:
        return _complain(f"{error.filename or 'input or output'}: {error.strerror or error}")
    except (click.Abort, KeyboardInterrupt):
        click.echo("optolever: interrupted", err=True)
        return 130
    return code if isinstance(code, int) else 0


def main() -> None:
    """Entry point of the console script."""
    sys.exit(run())


def _complain(message: str) -> int:
    click.echo("optolever: " + " ".join(message.split()), err=True)
    return 2
