"""`optolever explain`: the likeliest mistakes of a refused capture's order or description, or of a scene.

$ optolever explain pictures --sequence gray --pixels 1024x768 --out right.toml
Mistakes that explain the pictures
   explains  pictures numbered from 0
1  98 %      picture 0 is one too many, or every picture shows the image before
2  95 %      frame 1 is there twice, later ones are one late
Description of 1 in right.toml
"""

from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Literal

import click

import optolever as ol
from optolever import InputError

from .arguments import Arg, Opt, program
from .decode import CHANNEL, DESCRIPTION, MASK, WITHOUT, mask_of, read_capture
from .options import Display, Json, Pictured, blame, load_scene
from .outputs import OutputFile
from .printing import grid, number, print_notices, progress, write_json

OUT = Opt("--out TOML", "File to write a description to, for `decode --description`.", OutputFile(".toml"))
NAME = Opt("--take N", "Number of the mistake whose description is written.", click.IntRange(1))
SCENE = Opt("--scene PRESET_OR_TOML", "Explain heights: DIR is a correspondence, C.npz.", lists="scenes")


@program("explain", __doc__)
def command(
    sources: Annotated[tuple[Path, ...], Arg("DIR|PATTERN|FILE")],
    text: Pictured = None,
    display: Display = None,
    description: Annotated[Path | None, DESCRIPTION] = None,
    mask: Annotated[str | None, MASK] = None,
    channel: Annotated[Literal["red", "green", "blue", "luminance"], CHANNEL] = "luminance",
    left_out: Annotated[str | None, WITHOUT] = None,
    scene: Annotated[str | None, SCENE] = None,
    out: Annotated[Path | None, OUT] = None,
    take: Annotated[int, NAME] = 1,
    json_path: Json = None,
) -> int:
    """Name up to three mistakes that explain pictures which decode refuses.

    Each name is an order of the pictures or a description under which so much of the image fits. Read the
    description before you decode by it: no picture decides mirrored axes, a scale or a shift.
    """
    if scene is not None:
        found = ol.decode.Correspondence.load(sources[0])
        with blame(sources[0]):
            lines = ol.reconstruct.explain(found, load_scene(scene))
        click.echo("\n".join(map(str, lines)) or "no change of the scene explains the capture")
        return 0
    with progress() as step:
        step("read frames")
        capture = read_capture(sources, text, display, description, channel, left_out)
        step("explain")
        with blame(sources[0]):
            inside = mask_of(mask, capture.shape)
            mistakes = ol.decode.explain(capture.frames, capture.sequence, mask=inside)
    print_notices(capture.notices)
    numbers = [{**asdict(one), "sequence": one.sequence and one.sequence.to_dict()} for one in mistakes]
    write_json(json_path, {"mistakes": numbers})
    if not mistakes:
        click.echo("No known mistake explains the pictures better than their description.")
        return 0
    rows = [
        [str(k), number(100 * one.share, "%"), one.name + ("" if one.sequence else "; capture again")]
        for k, one in enumerate(mistakes, 1)
    ]
    grid("Mistakes that explain the pictures", ("", "explains", "pictures numbered from 0"), rows)
    if out is not None:
        _write(out, mistakes, take, sources, description, len(capture))
    return 0


def _write(
    out: Path,
    mistakes: "tuple[ol.decode.Mistake, ...]",
    take: int,
    sources: tuple[Path, ...],
    description: Path | None,
    count: int,
) -> None:
    if take > len(mistakes):
        raise InputError(f"--take {take}: must be 1 to {len(mistakes)}, as many mistakes were named")
    chosen = mistakes[take - 1]
    if chosen.sequence is None:
        raise InputError(f"--out {out}: no description mends {chosen.name!r}; capture again")
    files = ol.projector.picture_files(sources[0], description) if len(sources) == 1 else []
    files = files if len(files) == count else []
    if not files and chosen.pictures != tuple(range(len(chosen.pictures))):
        raise InputError(f"--out {out}: pictures are left out, which takes a folder of files; make one")
    ol.projector.write_description(out, chosen.sequence, [files[k] for k in chosen.pictures if files])
    click.echo(f"Description of {take} in {out}")
