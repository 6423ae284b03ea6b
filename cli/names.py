"""`optolever names`: names for --scene, --dent, --sequence and --method."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import click

from .options import json_option, load_scene, preset_option, sample
from .outputs import Program
from .show import table, write_json

__all__ = ["command"]

SAMPLE = """
$ optolever names
Scenes and methods
  scenes   monitor-mirror, paper-prototype, paper-simulation, prism48
  methods  coupled, paper, paper-rises, paper-drops
Sequences
  gray           axes=uv, inverses=true, cell=1
  ...
Dents, on paper-simulation (mm)
  flat
  tilt            slope=0.001
  raised-cosine   peak=1.3
  ...
"""


@click.command("names", cls=Program, epilog=sample(SAMPLE))
@preset_option("paper-simulation", text=", whose dents are listed")
@json_option
def command(scene_name: str, json_path: Path | None) -> None:
    """List the names that options take, parameters and defaults.

    A parameter without a value must be given (path) or follows from the others.
    """
    from optolever.experiments import PAPER_METHODS
    from optolever.patterns import sequence_names, sequence_parameters
    from optolever.reconstruct import method_names
    from optolever.scene import dent_names, dent_parameters, preset_names

    scene = load_scene(scene_name)
    names = {
        "scenes": list(preset_names()),
        "dents": list(dent_names()),
        "sequences": list(sequence_names()),
        "methods": [*method_names(), *PAPER_METHODS],
    }
    sequences = {name: sequence_parameters(name) for name in sequence_names()}
    dents = {name: dent_parameters(name, scene) for name in dent_names()}
    write_json(json_path, {**names, "parameters": {"sequences": sequences, "dents": dents}})
    table("Scenes and methods", {kind: ", ".join(names[kind]) for kind in ("scenes", "methods")})
    table("Sequences", {name: _text(values) for name, values in sequences.items()})
    table(f"Dents, on {scene.name} (mm)", {name: _text(values) for name, values in dents.items()})


def _text(values: Mapping[str, Any]) -> str:
    """name=value as an option takes it."""
    return ", ".join(key if value is None else f"{key}={_value(value)}" for key, value in values.items())


def _value(value: Any) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, tuple):
        return "/".join(map(_value, value))
    return f"{value:.4g}" if isinstance(value, float) else str(value)
