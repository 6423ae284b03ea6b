"""All hard cases: which there are, running them, and a picture of each failure."""

import re
from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from optolever.experiments.images import figure_png, new_figure
from optolever.files import atomic_file
from optolever.records import Progress, plot_maps, silent

from .found import Found, silent_mask
from .hard_case import Case, Result, run_case
from .hard_decode import decode_cases
from .hard_drawn import FORMS, curved_cases, height_cases, random_cases, scene_cases
from .hard_edges import edge_cases
from .hard_reconstruct import reconstruct_cases
from .hard_surroundings import surroundings_cases
from .hard_unlike import unlike_cases

DECODE_SIZE = (192, 192)
RECONSTRUCT_SIZES = ((128, 128), (256, 256))
EDGES_SIZE, UNLIKE_SIZE = (240, 320), (144, 192)
QUICK_SIZE = (96, 96)
DRAWS, QUICK_DRAWS = 24, 6
CURVED = 32  # scenes
QUICK_SURROUNDINGS = (144, 144)  # so that 3 % of them are 600 pixels


def hard_cases(
    sizes: tuple[tuple[int, int], ...] = (),
    wanted: str = "",
    quick: bool = False,
    drawn: int = 0,
    first: int = 0,
    draws: int = 0,
    every: bool = False,
) -> list[Case]:
    """The cases whose label holds every word of `wanted`. sizes: of cameras, default 192 x 192 (decode), 128
    and 256 squared (reconstruct); quick: 96 x 96 (surroundings 144 x 144), fewer sequences, double precision
    only; drawn: so many random ones instead, from number `first` on; draws: of scenes with edges, without and
    with a fault each, of scenes that are a little wrong and of rigs up to their height, 0: 24 (quick: 6), and
    of mirrors that bend inside of a pixel, 0: 32 (quick: 4); every: all surroundings, not a choice.
    """
    if drawn:
        return [
            case for case in random_cases(drawn, first) if all(word in case.label for word in wanted.split())
        ]
    several = draws or (QUICK_DRAWS if quick else DRAWS)
    small = (QUICK_SIZE,) if quick else ()
    cases: list[Case] = []
    for size in sizes or small or (DECODE_SIZE,):
        cases += decode_cases(size, quick)
    for size in sizes or ((QUICK_SURROUNDINGS,) if quick else (DECODE_SIZE,)):
        cases += surroundings_cases(size, quick, every)
    cases += reconstruct_cases(sizes or small or RECONSTRUCT_SIZES, quick)
    for size in sizes or (EDGES_SIZE,):
        cases += edge_cases(several, first, size)
    cases += scene_cases(several, first)
    for size in sizes or small or (UNLIKE_SIZE,):
        cases += unlike_cases(size)
    cases += height_cases(several, first)
    cases += curved_cases(draws or (len(FORMS) if quick else CURVED), first)
    return [case for case in cases if all(word in case.label for word in wanted.split())]


def run_hard(cases: Iterable[Case], progress: Progress = silent) -> Iterator[Result]:
    """Verdicts, one after the other."""
    listed = list(cases)
    for done, case in enumerate(listed):
        progress(f"{case.name}, {case.subject}", done, len(listed))
        yield run_case(case)


def save_picture(result: Result, folder: Path) -> Path | None:
    """Write a PNG of what went wrong into an existing folder; None if there is nothing to draw."""
    if result.found is None:
        return None
    name = re.sub(r"[^A-Za-z0-9.=-]+", "-", result.case.label).strip("-")
    path = folder / f"{name}.png"
    picture = figure_png(_figure(result, result.found))
    with atomic_file(path) as temporary:
        temporary.write_bytes(picture)
    return path


def _figure(result: Result, found: Found) -> Figure:
    """Error over its limit, silent pixels, flags."""
    with np.errstate(invalid="ignore", divide="ignore"):
        ratio = np.where(found.expected, np.abs(found.error) / found.limit, np.nan)
        flags = np.where(found.flags == 0, np.nan, np.log2(found.flags))
    wrong = silent_mask(found)
    maps = {
        "|error| / limit, log10, flagged or not": np.log10(np.clip(ratio, 1e-2, 1e2)),
        f"bright: {int(wrong.sum())} silent pixels; dark: flagged": np.where(wrong, 2, found.flags == 0),
        "flags: number of the highest bit": np.floor(flags),
    }
    figure = new_figure(13.0, 4.4)
    plot_maps(maps, figure.subplots(1, 3))
    figure.suptitle(f"{result.case.label}: {result.verdict}", fontsize=10)
    return figure
