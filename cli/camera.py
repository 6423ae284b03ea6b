"""`optolever camera`: the commands of a rig's camera and display."""

import click

from .commands import CAMERA, Commands


@click.group("camera", cls=Commands, sections={"Commands": CAMERA})
def command() -> None:
    """Camera: expose, sync, record, replay, measure."""
