"""Speed against error of codes, of a user's patterns and decoders, under faults of display and light: a row
per code and condition, predicted, simulated, or both."""

import math
from collections.abc import Iterator
from collections.abc import Sequence as Many
from dataclasses import asdict, dataclass, fields, replace
from itertools import product
from pathlib import Path

from optolever.errors import InputError
from optolever.files import write_rows
from optolever.patterns import Sequence
from optolever.records import Progress, silent
from optolever.samples import Faults
from optolever.scene import Scene, dent_from_text

from .candidates import Candidate, in_colour, user_candidate
from .sensitivity import Lever
from .view import predict

__all__ = [
    "Tradeoff", "compare_codes", "frame_rate", "predicted", "row_of", "simulated", "write_tradeoff_csv",
]  # fmt: skip


#: Minimum share of measured pixels of a code.
LEAST_SHARE = 0.5


def frame_rate(refresh: float, exposure_ms: float) -> float:
    """Frames per second: each lasts an integer number of refreshes, at least one and its exposure (ms)."""
    return refresh / max(1, math.ceil(1e-3 * exposure_ms * refresh - 1e-9))


@dataclass(frozen=True, slots=True)
class Tradeoff:
    """A code under noise (levels) and faults (see Faults; None: the scene's value).

    acquisition_seconds: of its frames; cpu_seconds: of decoding by a profile and solving one capture, median,
    and cpu_spread, half the range over the seeds; predicted, simulated: rms height error, mm (predicted: NaN
    with lag and for a user's decoder); spread: standard deviation of the simulated one over the seeds, mm;
    ratio: rms(error / sigma); share: of pixels with a height, simulated, else predicted; predicted_spread:
    relative standard error of predicted by the finite number of noise draws; failure: predicted share of
    pixels with an unflagged wrong order or bit; why: reason of exclusion ('': none).
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
    predicted_spread: float = math.nan
    failure: float = math.nan
    cpu_spread: float = math.nan
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
    colour: str | None = None,
    renderer: str = "auto",
    progress: Progress = silent,
) -> Iterator[Tradeoff]:
    """Every code ('PATTERN' or 'PATTERN@MODULE:FUNCTION') under every fault and noise, over seeds.
    calibrated: the decoder knows the response of the scene's display, but no fault's gamma. colour: also in
    colour, for stripes of that order."""
    pattern = scene.pattern
    named = [user_candidate(code, pattern.rows, pattern.cols, resized=resized) for code in codes]
    named += [] if colour is None else [*in_colour(named, colour)]
    total, done = len(named) * len(faults) * len(noises), 0
    for fault in faults:
        faulty = fault.on(scene)
        surface = dent_from_text(dent or scene.dent or "flat", faulty)
        lever = Lever(faulty, surface, calibrated=calibrated and fault.gamma is None)
        for noise, code in product(noises, named):
            progress("simulate", done, total)
            done += 1
            row = row_of(code, code.name, fault, noise, rate)
            if code.decoder is None and not row.lag:
                row = predicted(lever, row, code)
            yield row if row.why else simulated(lever, row, code, seeds, renderer)


def row_of(code: Candidate, name: str, fault: Faults, noise: float, rate: float) -> Tradeoff:
    """The row of a code without a result; rate: frames per second."""
    count = code.pattern.exposures if isinstance(code.pattern, Sequence) else len(code.pattern)
    return Tradeoff(name, noise, fault.lag, fault.gamma, fault.flicker, fault.blur, count, count / rate)


def predicted(lever: Lever, row: Tradeoff, code: Candidate) -> Tradeoff:
    """The row with its prediction, or with the reason for none."""
    try:
        there = predict(lever.view, code.sequence, row.noise, response=lever.response)
    except InputError as error:
        return replace(row, why=f"no prediction: {error}")
    height = lever.height(there)
    return replace(
        row,
        predicted=height.total,
        predicted_spread=height.spread,
        failure=there.failure,
        share=height.share,
    )


def simulated(lever: Lever, row: Tradeoff, code: Candidate, seeds: Many[int], renderer: str) -> Tradeoff:
    """The row with its simulation, or with the reason for none."""
    try:
        found = lever.simulate(code, row.noise, seeds, renderer, row.lag)
    except InputError as error:
        return replace(row, why=f"cannot be decoded: {error}")
    return replace(
        row,
        cpu_seconds=found.seconds,
        cpu_spread=found.seconds_spread,
        simulated=found.error,
        spread=found.spread,
        ratio=found.ratio,
        share=found.share,
    )


def write_tradeoff_csv(path: Path, rows: Many[Tradeoff]) -> None:
    """All rows under a header; unknown values are empty."""
    values = [[None if value != value else value for value in asdict(row).values()] for row in rows]
    write_rows(path, [field.name for field in fields(Tradeoff)], values)
