"""`optolever patterns`: sequences as pictures, for displays that other programs drive."""

from pathlib import Path
from typing import Annotated

import click

import optolever as ol

from .arguments import Arg, program, sample
from .options import Display, Json, Shown, shown_sequence
from .show import table, write_json

SAMPLE = """
$ optolever patterns export to-show --sequence gray+phase --pixels 640x480 \\
      --json to-show.json
Patterns in to-show
  sequence     gray+phase
  pictures     30 of 480 x 640
  description  to-show/capture.toml
"""


@click.group("patterns", epilog=sample(SAMPLE))
def command() -> None:
    """Write patterns as pictures, for any display."""


@command.add_command
@program("export", SAMPLE)
def export(
    out: Annotated[Path, Arg("DIR")],
    sequence: Shown = "gray+phase",
    display: Display = None,
    json_path: Json = None,
) -> None:
    """Write 000.png, 001.png, ... and the capture.toml that describes them.

    Show them in this order, one pattern pixel per screen pixel, and take a picture of each; then decode the
    pictures with --description DIR/capture.toml.
    """
    shown = shown_sequence(sequence, display)
    with ol.files.together():
        with ol.files.atomic_folder(out) as folder:
            shown.save_png(folder)
            ol.projector.write_description(folder / "capture.toml", shown)
        write_json(json_path, {"sequence": sequence, "frames": len(shown), "size": shown.shape[1:]})
    rows = {
        "sequence": sequence,
        "pictures": f"{len(shown)} of {shown.rows} x {shown.cols}",
        "description": str(out / "capture.toml"),
    }
    table(f"Patterns in {out}", rows)
