"""`python -m lab hard`: the hard cases of decode and reconstruct, a verdict for each."""

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import click

from optolever.cli.bench import interrupted
from optolever.cli.options import SIZE, json_option, sample
from optolever.cli.outputs import Program, report_option
from optolever.cli.show import grid, number, progress, table, write_json

if TYPE_CHECKING:
    from ..hard.hard_case import Pooled, Result

__all__ = ["command"]

SAMPLE = """
$ python -m lab hard --quick --filter "decode defocus" --out hard
Hard cases
part    case     subject     size   noise  input  error       flagged  wrong  silent  worst   verdict
decode  defocus  gray+phase  96x96  1      uint8  0.2178 px   19.4 %   0 %    0       0.7374  good
decode  defocus  phase       96x96  1      uint8  0.03426 px  10.26 %  0 %    0       0.7986  good
Verdict
  cases           2 of 2
  silently wrong  0
  pictures        hard
"""
HEADER = (
    "part",
    "case",
    "subject",
    "size",
    "noise",
    "input",
    "error",
    "flagged",
    "wrong",
    "silent",
    "worst",
    "verdict",
)


@click.command("hard", cls=Program, epilog=sample(SAMPLE))
@click.option("--size", "sizes", multiple=True, type=SIZE, metavar="ROWSxCOLS", help="Again for more.")
@click.option("--filter", "wanted", default="", metavar="WORDS", help="Only cases that hold all these words.")
@click.option("--quick", is_flag=True, help="96x96, fewer sequences, double precision only.")
@click.option(
    "--random", "drawn", type=click.IntRange(0), default=0, metavar="N", help="N random cases instead."
)
@click.option(
    "--draws",
    type=click.IntRange(0),
    default=0,
    metavar="N",
    help="N scenes with edges, N with a fault, N wrong scenes.",
)
@click.option("--first", type=click.IntRange(0), default=0, metavar="N", help="The first one's number.")
@click.option("--all", "every", is_flag=True, help="Every combination of surroundings, not a choice of them.")
@report_option("hard", "Gets the pictures.")
@json_option
def command(
    sizes: tuple[tuple[int, int], ...],
    wanted: str,
    quick: bool,
    drawn: int,
    draws: int,
    first: int,
    every: bool,
    out: Path,
    json_path: Path | None,
) -> int:
    """Decode and solve hard cases; look for errors without a flag.

    A row per case: rms error of the unflagged pixels, flagged share, share that is wrong (off by more than 5
    sigma; discrete codes by more than 1.5 px), flagged or not, silent errors (wrong and unflagged, of the
    unflagged) and the worst unflagged pixel over that limit. A case is good if
    at most 1e-4 of its unflagged pixels are silent errors. DIR gets a picture of every case that is not.
    In surroundings, a mirror that fills a part of the image is compared with the same pixels of an image that
    it fills: rms at most 1.1 times, flagged at most 3 % more, silent errors at most 1e-4 more; and frames
    swapped or lost that are detected there are detected here.
    Scenes with edges (edges) are drawn: objects at several depths, shadows, gloss, holes; a right frame
    must cost no pixel, a wrong one has to be named. Displays that do other than the sequence says (unlike)
    need a notice and a sigma that knows. Scenes (scene) are right, or a little wrong, without and with a
    capture of the mirror at rest: how many are noticed, how large the errors are.
    Random cases (even numbers: rig, mirror, code, light, noise, size, rendered by 36 rays a pixel; odd ones:
    mirrors for reconstruct) are the same for the same number. Rigs may have silent errors in 1e-3 of their
    pixels, or three pixels; all together in 1e-4, and a median flagged share of 5 %.
    Figures over all draws follow the rows.
    Exit code 1 if any case is silently wrong, or a figure over all draws is missed; where nobody could tell
    from the frames, the row says so.
    """
    from optolever.files import report_folder

    from ..hard.hard import hard_cases, run_hard, save_picture
    from ..hard.hard_case import pooled

    if first and not (drawn or draws):
        raise click.UsageError("--first goes with --random or --draws")
    if drawn and (sizes or quick or draws or every):
        raise click.UsageError("--random draws its sizes and rigs: no --size, --quick, --draws, --all")
    if quick and every:
        raise click.UsageError("--quick and --all exclude each other")
    cases = hard_cases(sizes, wanted, quick, drawn, first, draws, every)
    if not cases:
        raise click.UsageError(f"--filter {wanted!r}: no case holds these words")
    rows: list[list[str]] = []
    results: list[Result] = []
    faults = 0
    with report_folder(out), interrupted() as stopped, progress() as step:
        for result in run_hard(cases, step):
            rows.append(_cells(result))
            results.append(replace(result, found=None))
            faults += result.fault
            if result.fault:
                save_picture(result, out)
    figures = pooled(results)
    missed = sum(not figure.met for figure in figures)
    record = {"cases": [result.to_dict() for result in results], "faults": faults}
    write_json(json_path, {**record, "pooled": [figure.to_dict() for figure in figures]})
    grid("Hard cases", HEADER, rows)
    if figures:
        grid("Over all draws", ("figure", "value", "asked", "of"), [_pooled_cells(one) for one in figures])
    table(
        "Verdict",
        {"cases": f"{len(rows)} of {len(cases)}", "silently wrong": str(faults), "pictures": str(out)},
    )
    if stopped.hit:
        raise KeyboardInterrupt
    return 1 if faults or missed else 0


def _pooled_cells(figure: "Pooled") -> list[str]:
    sign = "at least" if figure.at_least else "at most"
    told = "" if figure.limit is None else f"{sign} {number(figure.limit)}"
    told += "" if figure.met else ", missed"
    return [figure.name, number(figure.value), told, str(figure.count)]


def _cells(result: "Result") -> list[str]:
    case = result.case
    error = number(result.error, result.unit) if result.unit else ""
    verdict = f"{result.verdict}: {result.why}" if result.why else result.verdict
    return [
        case.part,
        case.name,
        case.subject,
        f"{case.size[0]}x{case.size[1]}",
        f"{case.noise:g}",
        case.dtype,
        error,
        number(100 * result.flagged, "%"),
        number(100 * result.wrong, "%"),
        number(result.silent),
        number(result.worst),
        verdict if len(verdict) < 70 else verdict[:67] + "...",
    ]
