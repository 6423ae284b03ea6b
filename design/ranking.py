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
from optolever.samples import Faults
from optolever.scene import Scene, dent_from_text
from optolever.timing import Stages

from .candidates import Candidate, candidates, in_colour
from .sensitivity import Lever
from .tradeoff import LEAST_SHARE, Tradeoff, predicted, row_of, simulated

#: Maximum share of pixels with an unflagged wrong fringe order or bit.
MOST_FAILURES = 1e-3
#: Error of a pixel without a height, in rms errors of the measured pixels.
LOST = 5.0


@dataclass(frozen=True)
class Design:
    """Rows from best to worst by predicted and share (see merit), excluded ones last; candidates by the
    rows' codes; chosen: the best; settings, seconds.
    """

    rows: list[Tradeoff]
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
    colour: str | None = None,
    renderer: str = "auto",
    progress: Progress = silent,
) -> Design:
    """Rank the candidates of at most `frames` frames (and `extra` ones) for a scene, simulate the best.

    dent: as on the command line, default: the scene's dent or the mirror at rest. noise: rms, 8-bit levels,
    in addition to the sensor's noise. verify: number of the best candidates that are simulated, each with
    `seeds` draws of noise; those with a user's decoder are simulated only, listed last. lag: share of the
    preceding frame in each simulated frame. calibrated: the decoder knows the display's response. colour:
    also candidates in colour of at most as many pictures, for stripes of that order. InputError if nothing
    fits the budget.
    """
    pressed = dent or scene.dent or "flat"
    surface = dent_from_text(pressed, scene)
    pattern = scene.pattern
    offered = [*candidates(pattern.rows, pattern.cols, frames), *extra]
    if colour is not None:
        offered += in_colour(candidates(pattern.rows, pattern.cols, 3 * frames), colour, frames)
    by_text = {one.text: one for one in offered if one.decoder is None}
    if not by_text:
        raise InputError(f"frames: {frames}, no candidate fits; a fringe ladder on both axes needs 12")
    stages, fault = Stages(2, silent), Faults(lag)
    rows: list[Tradeoff] = []
    with stages.stage("predict"):
        lever = Lever(scene, surface, calibrated=calibrated)
        for name, one in by_text.items():
            progress("predict", len(rows), len(by_text))
            row = predicted(lever, row_of(one, name, fault, noise, refresh), one)
            rows.append(row if row.why else replace(row, why=_ruled_out(row)))
        rows.sort(key=lambda row: (bool(row.why), merit(row.predicted, row.share)))
    with stages.stage("simulate"):
        made = partial(simulated, lever, seeds=range(seeds), renderer=renderer)
        rows = _verified(rows, lambda row: made(row, by_text[row.code]), verify, progress)
        for one in (each for each in extra if each.decoder is not None):
            row = made(row_of(one, one.text, fault, noise, refresh), one)
            rows.append(replace(row, why=row.why or "own decoder: simulated only"))
    best = next((row for row in rows if not row.why), None)
    size = [scene.camera.rows, scene.camera.cols]
    settings = {"scene": scene.name, "dent": pressed, "size": size, "frames": frames, "refresh": refresh}
    settings |= {"noise": noise, "lag": lag, "blur": pattern.blur_px, "failure": MOST_FAILURES}
    return Design(rows, by_text, None if best is None else by_text[best.code], settings, stages.seconds)


def _ruled_out(row: Tradeoff) -> str:
    """Reason of exclusion of a row, '' for none."""
    if row.failure > MOST_FAILURES:
        return f"fails at {row.failure:.1e} of the pixels"
    if row.share < LEAST_SHARE:
        return f"measures {row.share:.0%} of the pixels"
    return ""


def _verified(
    rows: list[Tradeoff], simulate: Callable[[Tradeoff], Tradeoff], verify: int, progress: Progress
) -> list[Tradeoff]:
    """The best `verify` rows simulated, then the other rows; rows that cannot be decoded are last."""
    found, failed, remaining = list[Tradeoff](), list[Tradeoff](), list(rows)
    while remaining and len(found) < verify and not remaining[0].why:
        progress("simulate", len(found), verify)
        row = simulate(remaining.pop(0))
        (failed if row.why else found).append(row)
    return [*found, *remaining, *failed]
