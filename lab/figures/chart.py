"""Error of codes against pictures and CPU seconds: two scenes under three conditions, a panel each."""

from collections.abc import Iterator
from pathlib import Path

from optolever.calibration import measure_response
from optolever.design import (
    Candidate,
    Lever,
    Panel,
    Tradeoff,
    in_colour,
    row_of,
    run_design,
    simulated,
    user_candidate,
    write_tradeoff_chart,
)
from optolever.patterns import sequence
from optolever.projector import capture
from optolever.records import Progress
from optolever.samples import Faults
from optolever.scene import Scene, dent_from_text, load, resize

__all__ = ["CHARTS", "CONDITIONS", "DRAWS", "SCENES", "chart_rows", "write_charts"]

SCENES = {"prism48": (600, 800), "monitor-mirror": (512, 640)}  # pixels of the camera
CONDITIONS = {"photon noise": Faults(), "a lag of 10 %": Faults(lag=0.1), "a gamma of 2.2": Faults(gamma=2.2)}
CODES = {
    "phase, 3 steps": "phase:steps=3", "phase, 4 steps": "phase", "phase, 8 steps": "phase:steps=8",
    "close periods, 3 steps": "phase:steps=3,periods=9/10/11",
    "close periods, 4 steps": "phase:periods=9/10/11",
    "gray+phase": "gray+phase", "gray": "gray", "micro-phase": "micro-phase",
}  # fmt: skip
COLOURED = ("close periods, 4 steps", "gray+phase")  # also in colour, stripes in one place
BUDGETS = {12: "A", 18: "B", 24: "C"}  # pictures, of `optolever design`
CHARTS = {"frames": "error_pictures.png", "cpu_seconds": "error_seconds.png"}
DRAWS = 3
Rows = dict[str, tuple[Candidate, Tradeoff]]  # by the code's name


def chart_rows(progress: Progress) -> Iterator[tuple[str, str, Rows]]:
    """Scene, condition, their codes: named ones, and the ones of `design` for photon noise."""
    for at, (name, size) in enumerate(SCENES.items()):
        scene = resize(load(name, exact=True), *size)
        cells = scene.pattern.rows, scene.pattern.cols
        codes = {code: user_candidate(text, *cells) for code, text in CODES.items()}
        for code in COLOURED:
            codes |= {f"{code}, in colour": one for one in in_colour([codes[code]], "none")}
        for budget in BUDGETS:
            progress(f"{name}, design --frames {budget}", 6 * at, 12)
            best = run_design(scene, frames=budget, verify=0).chosen
            codes |= {} if best is None else {_designed(budget): best}
        for part, (condition, fault) in enumerate(CONDITIONS.items()):
            progress(f"{name}, {condition}", 6 * at + 3 + part, 12)
            lever = _lever(fault.on(scene), gamma=fault.gamma is not None)
            rows = {code: row_of(one, code, fault, 1.0, 60.0) for code, one in codes.items()}
            yield name, condition, {
                code: (codes[code], simulated(lever, row, codes[code], range(DRAWS), "auto"))
                for code, row in rows.items()
            }  # fmt: skip


def _lever(scene: Scene, *, gamma: bool) -> Lever:
    """gamma: with the response as a user measures it, by a ramp and by fringes of the mirror at rest."""
    lever = Lever(scene, dent_from_text(scene.dent or "flat", scene))
    if gamma:
        cells, flat = (scene.pattern.rows, scene.pattern.cols), dent_from_text("flat", scene)
        ramp, fringes = (capture(scene, flat, sequence(one, *cells), noise=1.0) for one in ("ramp", "phase"))
        lever.response = measure_response(ramp, [fringes]).response
    return lever


def _designed(budget: int) -> str:
    return f"optolever design --frames {budget}"


def write_charts(folder: Path, found: list[tuple[str, str, Rows]]) -> None:
    """A chart over pictures, and one over CPU seconds."""
    letters = {_designed(budget): letter for budget, letter in BUDGETS.items()}
    for cost, file in CHARTS.items():
        panels = [
            [
                Panel(f"{name}, {condition}", [row for _, row in rows.values()], cost)
                for name, condition, rows in found if name == scene
            ]
            for scene in SCENES
        ]  # fmt: skip
        write_tradeoff_chart(
            folder / file, panels, "ring: the default; diamond: found for photon noise", letters
        )
