"""`python -m lab live`: streams of single frames of all kinds, a vibration, a fringe in colour.

$ python -m lab live --streams 12 --pixels 160x120
Streams
kind          frames  trusted  noticed  wrong  silent  contacts  off  ratio
smooth press  12      ...
...
"""

from dataclasses import asdict
from functools import partial
from typing import Annotated

import click

from optolever.cli.arguments import Opt, program
from optolever.cli.options import Json, Seed, pixels
from optolever.cli.printing import grid, number, progress, table, write_json

__all__ = ["command"]


@program("live", __doc__)
def command(
    size: Annotated[tuple[int, int], pixels("Size of the camera.")] = (480, 640),
    streams: Annotated[int, Opt("--streams FRAMES", "Frames of every stream.", click.IntRange(1))] = 36,
    vibration: Annotated[bool, Opt("--vibration", "Only a surface that vibrates: 12 s at 60 Hz.")] = False,
    colour: Annotated[
        bool, Opt("--colour", "Only u in red and v in blue beside the crossed fringe.")
    ] = False,
    seed: Seed = 1,
    json_path: Json = None,
) -> None:
    """Follow dents and contacts of an independent renderer on prism48.

    Streams have 30 electrons a level: wrong are trusted frames with more than 0.1 % of the heights beyond
    five sigma, silent the ones without a notice; off are contacts whose depth is beyond five sigma.
    `figures --page live` measures time and errors.
    """
    measure = _vibration if vibration else _colour if colour else partial(_streams, frames=streams)
    write_json(json_path, measure(size, seed))


def _streams(size: tuple[int, int], seed: int, frames: int) -> dict[str, object]:
    import numpy as np

    from optolever.scene import load, resize

    from ..live.streams import KINDS, Tally, played, stream_rig

    rig, rng = stream_rig(resize(load("prism48"), *size)), np.random.default_rng(seed)
    tallies: dict[str, Tally] = {}
    with progress() as step:
        for name, kind in KINDS.items():
            tallies[name] = played(rig, kind, frames, rng)
            step(name)
    rows = [[name, *(number(value) for value in asdict(tally).values())] for name, tally in tallies.items()]
    grid("Streams", ("kind", *asdict(tallies["lamp"])), rows)
    return {name: asdict(tally) for name, tally in tallies.items()}


def _vibration(size: tuple[int, int], seed: int) -> dict[str, object]:
    """30 electrons a level; limits in brackets."""
    from optolever.scene import load, resize

    from ..live.figures import vibration
    from ..live.streams import stream_rig

    true = {7.0: 100.0, 11.0: 10.0}
    found = vibration(stream_rig(resize(load("prism48"), *size)), 12.0, true, seed=seed)
    rows = {f"{hz:g} Hz": f"{found.read_nm[hz]:.4g} nm of {nm:g}" for hz, nm in true.items()}
    rows["floor"] = f"{found.floor_nm:.3g} nm a bin (1)"
    rows["frame"] = f"{found.frame_nm:.3g} nm, {found.ms:.3g} ms"
    table("Vibration", rows)
    return asdict(found)


def _colour(size: tuple[int, int], seed: int) -> dict[str, object]:
    """Ratios: of the grey fringe with live's window over each."""
    from optolever.scene import load, resize

    from ..live.colour import shown
    from ..live.streams import stream_rig

    found = list(shown(stream_rig(resize(load("prism48"), *size)).prepared.rig.carriers, seed))
    rows = [
        [
            one.name, f"{one.window:g}", f"{one.noise:.2g} ({found[0].noise / one.noise:.3g})",
            f"{one.kept:.2f}", f"{one.error:.1g}",
        ]
        for one in found
    ]  # fmt: skip
    header = (
        "shown",
        "window, periods",
        "noise, turns (gain)",
        "of a bump of 3 px",
        "error of one of 12 px, turns",
    )
    grid("Colour in one exposure", header, rows)
    return {"rows": [one._asdict() for one in found]}
