"""`optolever camera`: the commands of a rig's camera and display."""

from collections.abc import Mapping, Sequence

import click

from .commands import CAMERA, Commands


class Camera(Commands):
    """optolever camera NAME."""

    sections: Mapping[str, Sequence[str]] = {"Commands": CAMERA}


@click.group("camera", cls=Camera)
def command() -> None:
    """Camera: devices, preview, expose, sync, record, replay, measure."""
