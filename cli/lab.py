"""`optolever lab`: the commands that measure and attack the program itself."""

import click

from .commands import Laboratory

__all__ = ["command"]


@click.group("lab", cls=Laboratory)
def command() -> None:
    """The laboratory: figures, hard cases, studies of designs.

    For those who work on the program, or want to know what a number of its pages rests on.
    """
