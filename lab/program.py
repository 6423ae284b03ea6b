"""The program `python -m lab`: commands that measure and attack optolever itself."""

from collections.abc import Mapping, Sequence

import click

from optolever.cli.app import exit_code
from optolever.cli.commands import Commands

#: Commands by section of --help.
SECTIONS: Mapping[str, tuple[str, ...]] = {
    "Figures": (
        "figures",
        "calibration",
        "contacts",
        "rigs",
        "sync",
        "live",
        "judgements",
        "colour",
        "house",
    ),
    "Attacks": ("fuzz",),
}
NAME = "python -m lab"


@click.group(
    cls=Commands,
    sections=SECTIONS,
    package=f"{__package__}.commands",
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
)
def lab() -> None:
    """The laboratory: figures, damaged inputs.

    For those who work on the program, or want to know what a number of its pages rests on.
    """


def run(args: Sequence[str] | None = None) -> int:
    """Run the laboratory on `args` (default: the process's); its exit code. Bad input never raises."""
    return exit_code(lambda: lab.main(args, NAME, standalone_mode=False), NAME)
