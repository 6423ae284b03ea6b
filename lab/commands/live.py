"""`python -m lab live`: heights of single frames, their time and error beside their limits.

$ python -m lab live
Live: 480 x 640, two float32 cosine transforms 1.983 ms
case     cell  ms     x transforms  error/depth       error/sigma  beyond 5 sigma  trusted
smooth   2     36.82  18.4 (14)     0.0016 (0.0002)   1.49         0               1
smooth   4     20.73  10.2 (8)      0.0019 (0.0002)   1.51         0               1
contact  2     46.49  21.6 (30)     0.00068 (0.001)   0.636        1e-05           1
contact  4     19.68  9.69 (15)     0.031 (0.001)     0.767        0.00085         0.8
"""

from dataclasses import asdict
from typing import Annotated

import click

from optolever.cli.arguments import Opt, program
from optolever.cli.options import Json, Seed, pixels
from optolever.cli.printing import grid, number, progress, table, write_json

__all__ = ["command"]


@program("live", __doc__)
def command(
    size: Annotated[tuple[int, int], pixels("Size of the camera.")] = (480, 640),
    streams: Annotated[
        int, Opt("--streams FRAMES", "Only streams of all kinds, of so many frames each.", click.IntRange(0))
    ] = 0,
    vibration: Annotated[bool, Opt("--vibration", "Only a surface that vibrates: 12 s at 60 Hz.")] = False,
    colour: Annotated[
        bool, Opt("--colour", "Only u in red and v in blue beside the crossed fringe.")
    ] = False,
    seed: Seed = 1,
    json_path: Json = None,
) -> None:
    """Follow dents and contacts of an independent renderer on prism48, noise of 1.5 levels.

    Time is that of one core beside two float32 cosine transforms of the same size in the same process; set
    OPTOLEVER_THREADS=1. Streams have 30 electrons a level: wrong are trusted frames
    with more than 0.1 % of the heights beyond five sigma, silent the ones without a notice; off are contacts
    whose depth is beyond five sigma."""
    from ..live.figures import live_rows, transforms_ms

    if streams:
        write_json(json_path, _streams(size, streams, seed))
        return
    if vibration:
        write_json(json_path, _vibration(size, seed))
        return
    if colour:
        write_json(json_path, _colour(size, seed))
        return
    rows = []
    with progress() as step:
        step("rest")
        for row in live_rows(size, (2, 4), seed):
            rows.append(row)
            step(f"{row.case}, cells of {row.cell}")
    header = ("case", "cell", "ms", "x transforms", "error/depth", "error/sigma", "beyond 5 sigma", "trusted")
    lines = [
        [
            row.case, str(row.cell), number(row.ms), f"{row.ratio:.3g} ({row.ratio_limit:g})",
            f"{row.error:.2g} ({row.error_limit:g})", f"{row.sigma_ratio:.3g}", f"{row.beyond:.2g}",
            f"{row.trusted:.3g}",
        ]
        for row in rows
    ]  # fmt: skip
    ours = number(transforms_ms(*size), "ms")
    grid(f"Live: {size[0]} x {size[1]}, two float32 cosine transforms {ours}", header, lines)
    write_json(json_path, {"rows": [asdict(row) for row in rows]})


def _streams(size: tuple[int, int], frames: int, seed: int) -> dict[str, object]:
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
