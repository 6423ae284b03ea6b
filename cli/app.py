"""The program `optolever`: commands that load when called, and the one place where errors become exit codes.

0: done. 2: the input cannot be used (one line on stderr says what, where, and the limit). 130: Ctrl-C.
"""

import gc
import sys
from collections.abc import Callable, Sequence
from typing import Any

import click

from optolever import InputError, __version__
from optolever.errors import reason_of

from .commands import SECTIONS, Commands

_GARBAGE = 50_000  # objects between collections: imports make many and no garbage, of 700 it takes .1 s


@click.group(
    cls=Commands,
    sections=SECTIONS,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
    epilog="Start with: optolever demo --out out/demo",
)
@click.version_option(__version__, prog_name="optolever")
def app() -> None:
    """Height of a deformable mirror from camera frames of patterns reflected in it.

    The chain is simulate (or camera measure) -> decode -> reconstruct -> report; demo runs all of it.
    """


def run(args: Sequence[str] | None = None) -> int:
    """Run the program on `args` (default: the process's); its exit code. Bad input never raises."""
    return exit_code(lambda: app.main(args, "optolever", standalone_mode=False), "optolever")


def exit_code(call: Callable[[], Any], name: str) -> int:
    """The exit code of a call of a program, called `name`."""
    try:
        code = call()
    except InputError as error:
        return _complain(name, str(error))
    except click.exceptions.NoArgsIsHelpError as error:
        click.echo(error.message)
        return 0
    except click.ClickException as error:
        context = getattr(error, "ctx", None)
        hint = f" (see {context.command_path} --help)" if context is not None else ""
        return _complain(name, f"{error.format_message()}{hint}")
    except MemoryError as error:
        from optolever.arrays import free_memory

        return _complain(name, f"{error or 'too little memory'}; {free_memory() / 2**30:.3g} GiB are free")
    except OSError as error:
        return _complain(name, f"{error.filename or 'input or output'}: {reason_of(error)}")
    except (click.Abort, KeyboardInterrupt) as error:
        click.echo("; ".join([f"{name}: interrupted", *map(str, (error.__cause__ or error).args)]), err=True)
        return 130
    return code if isinstance(code, int) else 0


def main() -> None:
    """Entry point of the console script."""
    gc.set_threshold(_GARBAGE)
    code = run()
    gc.freeze()  # else Python looks for cycles in all modules before it ends, for .2 to .3 s
    sys.exit(code)


def _complain(name: str, message: str) -> int:
    click.echo(f"{name}: " + " ".join(message.split()), err=True)
    return 2
