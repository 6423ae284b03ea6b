"""Speed against error of codes, of a user's patterns and decoders, under faults of display and light."""

import math
from collections.abc import Iterator
from collections.abc import Sequence as Many
from dataclasses import asdict, dataclass, fields, replace
from itertools import product
from pathlib import Path

from optolever.errors import InputError
from optolever.files import write_rows
from optolever.records import Progress, silent
from optolever.scene import Scene, dent_from_text

from ..faults import Faults
from .candidates import Candidate, user_candidate
from .sensitivity import Lever
from .view import predict

__all__ = ["Tradeoff", "compare_codes", "frame_rate", "write_tradeoff_csv"]


def frame_rate(refresh: float, exposure_ms: float) -> float:
    """Frames per second: each lasts an integer number of refreshes, at least one and its exposure (ms)."""
    return refresh / max(1, math.ceil(1e-3 * exposure_ms * refresh - 1e-9))


@dataclass(frozen=True, slots=True)
class Tradeoff:
    """A code under noise (levels) and faults (see Faults; None: the scene's value).

    acquisition_seconds: of its frames; cpu_seconds: of decoding and solving one capture, a minimum;
    predicted, simulated: rms height error, mm (predicted: NaN with lag and for a user's decoder); spread:
    standard deviation of the simulated one over the seeds, mm; ratio: rms(error / sigma); share: of pixels
    with a height.
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
    spread: float = math.nan
    ratio: float = math.nan
    share: float = math.nan
    why: str = ""

    @property
    def condition(self) -> str:
        """Noise and faults in words."""
        known = {"lag": self.lag or None, "gamma": self.gamma, "flicker": self.flicker, "blur": self.blur}
        faults = (f"{name} {value:g}" for name, value in known.items() if value is not None)
        return ", ".join([f"noise {self.noise:g}", *faults])


def compare_codes(
    scene: Scene,
    dent: str | None,
    codes: Many[str],
    *,
    faults: Many[Faults],
    noises: Many[float],
    rate: float = 60.0,
    seeds: Many[int] = (0,),
    calibrated: bool = False,
    resized: bool = False,
    renderer: str = "auto",
    progress: Progress = silent,
) -> Iterator[Tradeoff]:
    """Every code ('PATTERN' or 'PATTERN@MODULE:FUNCTION') under every fault and noise, over seeds.
    calibrated: the decoder knows the response of the scene's display, but no fault's gamma."""
    pattern = scene.pattern
    named = [user_candidate(code, pattern.rows, pattern.cols, resized=resized) for code in codes]
    total, done = len(codes) * len(faults) * len(noises), 0
    for fault in faults:
        faulty = fault.on(scene)
        surface = dent_from_text(dent or scene.dent or "flat", faulty)
        lever = Lever(faulty, surface, calibrated=calibrated and fault.gamma is None)
        for noise, code in product(noises, named):
            progress("simulate", done, total)
            done += 1
            count = len(code.pattern)
            values = fault.lag, fault.gamma, fault.flicker, fault.blur
            row = Tradeoff(code.name, noise, *values, count, count / rate)
            try:
                yield _simulated(lever, row, code, seeds, renderer)
            except InputError as error:
                yield replace(row, why=str(error))


def _simulated(lever: Lever, row: Tradeoff, code: Candidate, seeds: Many[int], renderer: str) -> Tradeoff:
    """The row with its numbers."""
    if code.decoder is None and not row.lag:
        there = lever.height(predict(lever.view, code.sequence, row.noise, response=lever.response))
        row = replace(row, predicted=there.total)
    found = lever.simulate(code, row.noise, seeds, renderer, row.lag)
    return replace(
        row,
        cpu_seconds=found.seconds,
        simulated=found.error,
        spread=found.spread,
        ratio=found.ratio,
        share=found.share,
    )


def write_tradeoff_csv(path: Path, rows: Many[Tradeoff]) -> None:
    """All rows under a header; unknown values are empty."""
    values = [[None if value != value else value for value in asdict(row).values()] for row in rows]
    write_rows(path, [field.name for field in fields(Tradeoff)], values)
