"""Speed against error of codes, of a user's patterns and decoders, under faults of display and light."""

import math
from collections.abc import Iterator
from collections.abc import Sequence as Many
from dataclasses import asdict, dataclass, fields, replace
from itertools import product
from pathlib import Path

from optolever.errors import InputError
from optolever.files import atomic_file, write_rows
from optolever.records import Progress, silent
from optolever.scene import Scene, dent_from_text

from ..faults import Faults
from ..images import label_axes, new_figure
from ..metrics import rms
from ..timing import timed
from .candidates import Candidate, user_candidate
from .sensitivity import Lever
from .view import predict

__all__ = ["Tradeoff", "compare_codes", "frame_rate", "write_tradeoff_chart", "write_tradeoff_csv"]


def frame_rate(refresh: float, exposure_ms: float) -> float:
    """Frames per second: each lasts an integer number of refreshes, at least one and its exposure (ms)."""
    return refresh / max(1, math.ceil(1e-3 * exposure_ms * refresh - 1e-9))


@dataclass(frozen=True, slots=True)
class Tradeoff:
    """A code under noise (levels) and faults (see Faults; None: the scene's value).

    acquisition_seconds: of its frames; cpu_seconds: of decoding and solving one capture; predicted,
    simulated: rms height error, mm (predicted: NaN with lag and for a user's decoder); share: of pixels with
    a height.
    """

    code: str
    noise: float
    lag: float
    gamma: float | None
    flicker: float | None
    blur: float | None
    frames: int
    acquisition_seconds: float
    cpu_seconds: float = math.nan
    predicted: float = math.nan
    simulated: float = math.nan
    share: float = math.nan
    why: str = ""


def compare_codes(
    scene: Scene,
    dent: str | None,
    codes: Many[str],
    *,
    faults: Many[Faults],
    noises: Many[float],
    rate: float = 60.0,
    resized: bool = False,
    renderer: str = "auto",
    progress: Progress = silent,
) -> Iterator[Tradeoff]:
    """Every code ('PATTERN' or 'PATTERN@MODULE:FUNCTION') under every fault and noise, by one seed of it."""
    pattern = scene.pattern
    named = [user_candidate(code, pattern.rows, pattern.cols, resized=resized) for code in codes]
    total, done = len(codes) * len(faults) * len(noises), 0
    for fault in faults:
        faulty = fault.on(scene)
        lever = Lever(faulty, dent_from_text(dent or scene.dent or "flat", faulty))
        for noise, code in product(noises, named):
            progress("simulate", done, total)
            done += 1
            count = len(code.pattern)
            values = fault.lag, fault.gamma, fault.flicker, fault.blur
            row = Tradeoff(code.text, noise, *values, count, count / rate)
            try:
                yield _simulated(lever, row, code, renderer)
            except InputError as error:
                yield replace(row, why=str(error))


def _simulated(lever: Lever, row: Tradeoff, code: Candidate, renderer: str) -> Tradeoff:
    """The row with its numbers."""
    if code.decoder is None and not row.lag:
        row = replace(row, predicted=lever.height(predict(lever.view, code.sequence, row.noise)).total)
    frames = lever.frames(code.pattern, row.noise, 0, renderer, row.lag)
    lever.solved(frames, code)  # compiles
    taken = timed(lambda: lever.solved(frames, code))
    height, full = taken.value, lever.full
    good = height.good & full.usable
    error, share = rms((height.z - full.truth.z)[good]), float(good.sum() / full.usable.sum())
    return replace(row, cpu_seconds=taken.processor, simulated=error, share=share)


def write_tradeoff_csv(path: Path, rows: Many[Tradeoff]) -> None:
    """All rows under a header; unknown values are empty."""
    values = [[None if value != value else value for value in asdict(row).values()] for row in rows]
    write_rows(path, [field.name for field in fields(Tradeoff)], values)


def write_tradeoff_chart(path: Path, rows: Many[Tradeoff]) -> None:
    """Error over CPU seconds and seconds of acquisition; a line per code (o simulated, x predicted)."""
    figure = new_figure(10.0, 4.0)
    axes = figure.subplots(1, 2, sharey=True)
    for number, code in enumerate(dict.fromkeys(row.code for row in rows)):
        mine = [row for row in rows if row.code == code and row.simulated > 0]
        for panel, name in zip(axes, ("cpu_seconds", "acquisition_seconds"), strict=True):
            seconds = [getattr(row, name) for row in mine]
            panel.loglog(
                seconds, [row.simulated for row in mine], "o-", ms=4, lw=1, color=f"C{number}", label=code
            )
            panel.loglog(seconds, [row.predicted for row in mine], "x", color=f"C{number}")
    label_axes(axes[0], "CPU seconds to decode and solve", "rms height error [mm]", "")
    label_axes(axes[1], "seconds to acquire", "", "")
    axes[1].legend(fontsize=8, frameon=False)
    with atomic_file(path) as temporary:
        figure.savefig(temporary, format="png", dpi=120)
