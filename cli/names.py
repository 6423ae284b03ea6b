"""`optolever names`: what --scene, --dent and --sequence understand."""

from pathlib import Path

import click

from .options import json_option, sample
from .outputs import Program
from .show import table, write_json

__all__ = ["command"]

SAMPLE = """
$ optolever names
Names
  scenes     monitor-mirror, paper-prototype, paper-simulation, prism48
  dents      flat, tilt, raised-cosine, gaussian, ball, needle, rounded-needle,
             ridge, relief
  sequences  gray, binary, xor-gray, long-run-gray, phase, gray+phase,
             micro-phase, stripe, spot, lattice, crossed, ramp
  methods    coupled, direct, robust, march, fixed-point, paper, paper-rises,
             paper-drops
"""


@click.command("names", cls=Program, epilog=sample(SAMPLE))
@json_option
def command(json_path: Path | None) -> None:
    """List the scenes, dents, sequences and methods that the other commands take by name."""
    from optolever.patterns import sequence_names
    from optolever.reconstruct import method_names
    from optolever.scene import dent_names, preset_names

    names = {
        "scenes": list(preset_names()),
        "dents": list(dent_names()),
        "sequences": list(sequence_names()),
        "methods": list(method_names()),
    }
    write_json(json_path, names)
    table("Names", {kind: ", ".join(entries) for kind, entries in names.items()})
