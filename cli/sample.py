"""`optolever sample`: complete sets of captures to begin with, and the commands that go on from them.

$ optolever sample sensor --out sensor
sensor: a rig, its captures, and the truth apart. It goes on with:
  optolever response sensor/ramp sensor/rest --scene sensor/rig.toml
  ...
"""

from pathlib import Path
from typing import Annotated

import click

import optolever as ol

from .arguments import Arg, Opt, program
from .options import Json, Seed
from .outputs import NewFolder
from .printing import progress, write_json

NAMES = ["sensor", "mirror", "forty", "design"]
OUT = Opt("--out DIR", "Folder to make; default: the name of the set.", NewFolder())


@program("sample", __doc__)
def command(
    name: Annotated[str, Arg("|".join(NAMES), click.Choice(NAMES))],
    out: Annotated[Path | None, OUT] = None,
    seed: Seed = 0,
    json_path: Json = None,
) -> None:
    """Make captures to begin with, as a rig would.

    sensor: a pressed prism; mirror: flats and a mirror in open air; forty: forty presses; design: a rig to
    choose patterns for. Pictures are JPEG with photon noise and gamma 2.2, of the mirror through a lens with
    distortion; rig.toml is typed a bit wrong; DIR/truth holds the truth.
    """
    folder = Path(name) if out is None else out
    with progress() as step:
        step("simulate")
        commands = ol.samples.write_sample(name, folder, seed)
    write_json(json_path, {"commands": commands})
    click.echo(f"{folder}: a rig, its captures, and the truth apart. It goes on with:")
    for line in commands:
        click.echo(f"  {line}")
