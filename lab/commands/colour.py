"""`python -m lab colour`: three patterns in a picture against the same patterns in grey.

$ python -m lab colour --seeds 1 --pixels 120x90
Heights of a dent on prism48
sequence               case       exposures  height  over grey  places e/s  heights e/s  > 5 sigma
phase:periods=9/10/11  nominal    8          92 nm   1.2        0.92        0.9          0
...
"""

from typing import Annotated, Any

import click

from optolever import InputError
from optolever.cli.arguments import Opt, Shape, program
from optolever.cli.options import Json, preset
from optolever.cli.printing import grid, progress, write_json

__all__ = ["command"]


@program("colour", __doc__)
def command(
    seeds: Annotated[int, Opt("--seeds N", "Captures of every kind.", click.IntRange(1))] = 4,
    size: Annotated[tuple[int, int], Opt("--pixels WIDTHxHEIGHT", "Of the camera.", Shape(8))] = (240, 320),
    scene: Annotated[str, preset()] = "prism48",
    json_path: Json = None,
) -> None:
    """Errors by three patterns in a picture, over the same in grey with three times the pictures.

    Photon noise of 30 electrons a level, crosstalk of 10 to 14 %: nominal, lag, gamma, a mix that is off and
    known to be, flicker, stripes, a mosaic. places, heights, grey's: error over sigma, of heights in grey.
    """
    from ..figures.exposures import CASES, compared

    rows, numbers = [], list[dict[str, Any]]()
    with progress() as step:
        for text in ("phase:periods=9/10/11", "gray+phase"):
            for name, case in CASES.items():
                step(f"{text}, {name}")
                try:
                    found, grey = (compared(text, case, seeds, size, c, scene) for c in (True, False))
                except InputError as refused:
                    rows.append([text, name, "refused", *7 * [""]])
                    numbers.append({"sequence": text, "case": name, "refused": str(refused)})
                    continue
                figures = found.height_nm / grey.height_nm, found.places, found.heights, grey.heights
                rows.append(
                    [text, name, str(found.exposures), f"{found.height_nm:.3g} nm"]
                    + [f"{one:.2f}" for one in figures]
                    + [f"{found.beyond:.1e}", f"{100 * found.good:.0f} %", "yes" if found.named else ""]
                )
                both = {"grey": grey._asdict(), "colour": found._asdict()}
                numbers.append({"sequence": text, "case": name, **both})
    errors = ("height", "over grey", "places", "heights", "grey's", "> 5", "good", "named")
    head = ("sequence", "case", "exposures", *errors)
    grid(f"Heights of a dent on {scene}", head, rows)
    write_json(json_path, {"seeds": seeds, "scene": scene, "size": list(size), "figures": numbers})
