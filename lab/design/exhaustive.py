"""Is the first choice of run_design the right one? Against simulating every candidate, on ten scenes that
stand, and as many as wanted drawn by number.
"""

import math
import time
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from optolever.errors import InputError
from optolever.experiments.design import Lever, merit, run_design, simulate, varied
from optolever.records import Progress, silent
from optolever.scene import Scene, dent_from_text, load, resize

from .drawn import between, dent_params

#: Simulated again are those whose merit is over the least one's by up to so much.
CLOSE = 1.12
#: Predictions are right within so much.
LIMIT = 0.15


@dataclass(frozen=True, slots=True)
class Case:
    """A scene to choose for: preset, what is varied (see varied), dent, blur in cells, noise, frames."""

    preset: str
    dent: str
    blur: float
    noise: float
    frames: int
    changes: tuple[tuple[str, float], ...] = ()

    def scene(self, pixels: int) -> Scene:
        """The scene, with `pixels` along the camera's shorter side."""
        scene = load(self.preset, exact=True)
        for name, value in self.changes:
            scene = varied(scene, name, value)
        by = pixels / min(scene.camera.rows, scene.camera.cols)
        scene = resize(scene, round(scene.camera.rows * by), round(scene.camera.cols * by))
        return replace(scene, pattern=replace(scene.pattern, blur_px=self.blur))

    @property
    def name(self) -> str:
        """The case in a few words."""
        changes = "".join(f" {name} {value:g}" for name, value in self.changes)
        limits = f"blur {self.blur:g}, noise {self.noise:g}, {self.frames} frames"
        return f"{self.preset}{changes}, {self.dent}, {limits}"


#: Ten scenes; no number was fitted to them.
CASES = (
    Case("prism48", "ridge:peak=0.1,sigma=5", 0.5, 0.5, 20, (("angle", 50.0),)),
    Case("prism48", "gaussian:peak=0.1,sigma=10", 1.0, 1.0, 28, (("index", 1.49),)),
    Case("prism48", "flat", 0.6, 3.0, 24, (("distance", 5.0),)),
    Case("prism48", "raised-cosine:peak=0.2", 1.5, 2.0, 32, (("angle", 46.0),)),
    Case("paper-simulation", "gaussian:peak=0.6,sigma=25", 0.7, 2.0, 18),
    Case("paper-simulation", "ball:peak=0.4", 0.4, 1.0, 16, (("pattern", 0.7),)),
    Case("paper-simulation", "rounded-needle:peak=0.3", 2.0, 1.0, 36),
    Case("monitor-mirror", "gaussian:peak=0.05,sigma=15", 0.5, 1.0, 20),
    Case("monitor-mirror", "flat", 1.2, 4.0, 40, (("distance", 100.0),)),
    Case("monitor-mirror", "ridge:peak=0.05,sigma=12", 0.8, 0.5, 14, (("pattern", 1.5),)),
)

#: What is varied on each preset, and between what.
_CHANGES = {
    "prism48": {"angle": (46.0, 52.0), "index": (1.4, 1.6), "distance": (1.0, 8.0), "pattern": (0.6, 1.5)},
    "paper-simulation": {"index": (1.4, 1.6), "distance": (1.0, 15.0), "pattern": (0.6, 1.5)},
    "paper-prototype": {"index": (1.42, 1.6), "distance": (0.5, 5.0), "pattern": (0.4, 1.0)},
    "monitor-mirror": {"distance": (20.0, 200.0), "pattern": (0.6, 1.5)},
}
#: Dents that are drawn.
_DENTS = ("flat", "raised-cosine", "gaussian", "ridge", "rounded-needle", "ball")


def drawn_cases(count: int, first: int = 0) -> Iterator[Case]:
    """`count` cases that nobody has thought of; a number's case is always the same."""
    for number in range(first, first + count):
        yield _drawn(np.random.default_rng([1999, number]))


def _drawn(rng: np.random.Generator) -> Case:
    preset = str(rng.choice(list(_CHANGES)))
    changes: tuple[tuple[str, float], ...] = ()
    if rng.random() < 0.7:
        name = str(rng.choice(list(_CHANGES[preset])))
        changes = ((name, _round(rng.uniform(*_CHANGES[preset][name]))),)
    form = str(rng.choice(_DENTS))
    pressed = _dent(form, load(preset, exact=True), between(rng, 0.1, 0.7), between(rng, 0.5, 1.5))
    blur, noise = _round(rng.uniform(0.3, 2)), _round(between(rng, 0.4, 4))
    return Case(preset, pressed, blur, noise, int(rng.integers(14, 41)), changes)


def _dent(form: str, scene: Scene, depth: float, width: float) -> str:
    """A dent of a form as on the command line; depth, width: in units of the usual one's."""
    if form == "flat":
        return form
    params = dent_params(form, scene, depth, width)
    return f"{form}:" + ",".join(f"{name}={_round(value):g}" for name, value in params.items())


def _round(value: float) -> float:
    """To two digits: names stay short."""
    return float(f"{value:.2g}")


@dataclass(frozen=True, slots=True)
class ChoiceRow:
    """One case: the choice, its simulated error (mm) and share, the best of all simulated and the same of it;
    excess: how much worse the choice's merit is (0: the best); candidates that nothing rules out, the share
    of them predicted within 15 %, of the others predicted over simulated error, the worst first; median of
    |predicted / simulated - 1|; seconds that it took."""

    case: str
    chosen: str
    chosen_error: float
    chosen_share: float
    best: str
    best_error: float
    best_share: float
    excess: float
    candidates: int
    within_15: float
    outside: dict[str, float]
    median_error: float
    seconds: float


def run_choice(
    case: Case,
    *,
    pixels: int = 72,
    seeds: int = 12,
    more: int = 40,
    renderer: str = "auto",
    progress: Progress = silent,
) -> ChoiceRow:
    """Choose for a case, simulate every candidate with `seeds` draws, the best ones with `more`."""
    start = time.perf_counter()
    scene = case.scene(pixels)
    design = run_design(
        scene, case.dent, frames=case.frames, noise=case.noise, renderer=renderer, progress=progress
    )
    if design.chosen is None:
        raise InputError(f"case {case.name}: nothing meets the limits")
    chosen = design.chosen.text
    lever = Lever(scene, dent_from_text(case.dent, scene), stride=1)
    found = {chosen: (math.nan, 0.0)}

    def simulated(texts: set[str], draws: range) -> None:
        for done, text in enumerate(sorted(texts)):
            progress(f"simulate with {len(draws)} draws", done, len(texts))
            with suppress(InputError):  # it cannot be decoded, or a draw leaves no anchor
                found[text] = simulate(lever, design.candidates[text], case.noise, draws, renderer)

    simulated(set(design.candidates), range(100, 100 + seeds))
    least = min(merit(*error) for error in found.values())
    close = {text for text, error in found.items() if merit(*error) < CLOSE * least} | {chosen}
    simulated(close, range(200, 200 + more))
    best = min(close, key=lambda text: merit(*found[text]))
    ratios = {
        row.text: row.predicted / found[row.text][0]
        for row in design.rows
        if not row.why and row.text in found and found[row.text][0] > 0
    }
    off = {text: abs(ratio - 1) for text, ratio in ratios.items()}
    outside = {text: ratios[text] for text in sorted(off, key=lambda text: -off[text]) if off[text] > LIMIT}
    return ChoiceRow(
        case.name, chosen, *found[chosen], best, *found[best],
        merit(*found[chosen]) / merit(*found[best]) - 1, len(ratios), 1 - len(outside) / max(1, len(ratios)),
        outside, float(np.median(list(off.values()))), time.perf_counter() - start,
    )  # fmt: skip
