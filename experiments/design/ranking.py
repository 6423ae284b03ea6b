"""run_design: rank candidate sequences within a budget of frames by predicted height error, and simulate the
best.
"""

import math
from collections.abc import Callable
from collections.abc import Sequence as Many
from dataclasses import asdict, dataclass, replace
from functools import partial
from typing import Any

from optolever.errors import InputError
from optolever.records import Progress, silent
from optolever.scene import Scene, dent_from_text

from ..timing import Stages
from .candidates import Candidate, candidates
from .sensitivity import Lever, Simulation
from .view import predict

#: Minimum predicted share of measured pixels.
LEAST_SHARE = 0.5
#: Maximum share of pixels with an unflagged wrong fringe order or bit.
MOST_FAILURES = 1e-3
#: Error of a pixel without a height, in rms errors of the measured pixels.
LOST = 5.0


@dataclass(frozen=True, slots=True)
class DesignRow:
    """One candidate. predicted, noise, bias: rms height error and its parts (mm); spread: relative standard
    error of predicted by the finite number of noise draws; failure: share of pixels with an unflagged wrong
    order or bit; share: predicted share of measured pixels; why: reason of exclusion ('': none).

    predicted and share determine the rank (see merit). simulated, simulated_share: the same from rendered
    frames, simulated_spread: its standard deviation over the seeds (mm), NaN if not simulated.
    """

    text: str
    frames: int
    seconds: float
    predicted: float = math.nan
    spread: float = math.nan
    noise: float = math.nan
    bias: float = math.nan
    failure: float = math.nan
    share: float = math.nan
    why: str = ""
    simulated: float = math.nan
    simulated_share: float = math.nan
    simulated_spread: float = math.nan


@dataclass(frozen=True)
class Design:
    """Rows from best to worst, excluded ones last; candidates by text; chosen: the best; settings,
    seconds.
    """

    rows: list[DesignRow]
    candidates: dict[str, Candidate]
    chosen: Candidate | None
    settings: dict[str, Any]
    seconds: dict[str, float]

    def to_dict(self) -> dict[str, Any]:
        """Plain values."""
        return {
            "chosen": None if self.chosen is None else self.chosen.text,
            "rows": [asdict(row) for row in self.rows],
            "settings": self.settings,
            "seconds": self.seconds,
        }


def merit(error: float, share: float) -> float:
    """Figure of merit: rms height error (mm) over all pixels, where a pixel without a height counts as LOST
    times the rms of the others; infinite without any height."""
    return error * math.sqrt(share + LOST**2 * (1 - share)) if error > 0 and share > 0 else math.inf


def run_design(
    scene: Scene,
    dent: str | None = None,
    *,
    frames: int = 24,
    refresh: float = 60.0,
    noise: float = 1.0,
    verify: int = 3,
    seeds: int = 3,
    extra: Many[Candidate] = (),
    lag: float = 0.0,
    calibrated: bool = False,
    renderer: str = "auto",
    progress: Progress = silent,
) -> Design:
    """Rank the candidates of at most `frames` frames (and `extra` ones) for a scene, simulate the best.

    dent: as on the command line, default: the scene's dent or the mirror at rest. noise: rms, 8-bit levels,
    in addition to the sensor's noise. verify: number of the best candidates that are simulated, each with
    `seeds` draws of noise; those with a user's decoder are simulated only, listed last. lag: share of the
    preceding frame in each simulated frame. calibrated: the decoder knows the display's response. InputError
    if nothing fits the budget.
    """
    pressed = dent or scene.dent or "flat"
    surface = dent_from_text(pressed, scene)
    pattern = scene.pattern
    offered = [*candidates(pattern.rows, pattern.cols, frames), *extra]
    by_text = {one.text: one for one in offered if one.decoder is None}
    if not by_text:
        raise InputError(f"frames: {frames}, no candidate fits; a fringe ladder on both axes needs 12")
    stages = Stages(2, silent)
    rows: list[DesignRow] = []
    with stages.stage("predict"):
        lever = Lever(scene, surface, calibrated=calibrated)
        for one in by_text.values():
            progress("predict", len(rows), len(by_text))
            rows.append(_predicted(lever, one, noise, refresh))
        rows.sort(key=lambda row: (bool(row.why), merit(row.predicted, row.share)))
    with stages.stage("simulate"):
        simulated = partial(lever.simulate, noise=noise, seeds=range(seeds), renderer=renderer, lag=lag)
        rows = _verified(rows, lambda row: _simulated(row, by_text[row.text], simulated), verify, progress)
        for one in (each for each in extra if each.decoder is not None):
            row = DesignRow(
                one.text, len(one.pattern), len(one.pattern) / refresh, why="own decoder: simulated only"
            )
            row = _simulated(row, one, simulated)
            rows.append(replace(row, share=row.simulated_share))
    best = next((row for row in rows if not row.why), None)
    size = [scene.camera.rows, scene.camera.cols]
    settings = {"scene": scene.name, "dent": pressed, "size": size, "frames": frames, "refresh": refresh}
    settings |= {"noise": noise, "lag": lag, "blur": pattern.blur_px, "failure": MOST_FAILURES}
    return Design(rows, by_text, None if best is None else by_text[best.text], settings, stages.seconds)


def _predicted(lever: Lever, candidate: Candidate, noise: float, refresh: float) -> DesignRow:
    """The predicted row of a candidate."""
    count = len(candidate.sequence)
    row = DesignRow(candidate.text, count, count / refresh)
    try:
        prediction = predict(lever.view, candidate.sequence, noise, response=lever.response)
    except InputError as error:
        return replace(row, why=f"no prediction: {error}")
    height = lever.height(prediction)
    row = replace(row, predicted=height.total, spread=height.spread, noise=height.noise, bias=height.bias)
    row = replace(row, failure=prediction.failure, share=height.share)
    return replace(row, why=_ruled_out(row))


def _simulated(row: DesignRow, one: Candidate, simulated: Callable[[Candidate], Simulation]) -> DesignRow:
    """The row with its simulation, or with the reason for none."""
    try:
        found = simulated(one)
    except InputError as error:
        return replace(row, why=f"cannot be decoded: {error}")
    return replace(row, simulated=found.error, simulated_share=found.share, simulated_spread=found.spread)


def _ruled_out(row: DesignRow) -> str:
    """Reason of exclusion of a row, '' for none."""
    if row.failure > MOST_FAILURES:
        return f"fails at {row.failure:.1e} of the pixels"
    if row.share < LEAST_SHARE:
        return f"measures {row.share:.0%} of the pixels"
    return ""


def _verified(
    rows: list[DesignRow], simulated: Callable[[DesignRow], DesignRow], verify: int, progress: Progress
) -> list[DesignRow]:
    """The best `verify` rows simulated, then the other rows; rows that cannot be decoded are last."""
    found, failed, remaining = list[DesignRow](), list[DesignRow](), list(rows)
    while remaining and len(found) < verify and not remaining[0].why:
        progress("simulate", len(found), verify)
        row = simulated(remaining.pop(0))
        (failed if row.why else found).append(row)
    return [*found, *remaining, *failed]
