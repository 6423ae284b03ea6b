"""What `design` says the decoder will find out about a display's blur, against it; what its cases found."""

from dataclasses import replace

import numpy as np
import pytest

from optolever.decode import decode, decoder
from optolever.decode.plan import AxisPlan, Plan
from optolever.decode.survey import Survey
from optolever.decode.swing import Blur
from optolever.experiments.design import CASES, candidates, drawn_cases, view_of
from optolever.experiments.design.prediction import predict_axis
from optolever.experiments.design.survey import blur_told
from optolever.patterns import sequence
from optolever.projector import capture
from optolever.reconstruct import reconstruct
from optolever.scene import Scene, dent, dent_from_text, load, resize, trace

CAPTURES = 6


def prototype(blur: float) -> Scene:
    """Pixels of about a cell and a half."""
    scene = resize(load("paper-prototype"), 96, 96)
    return replace(scene, pattern=replace(scene.pattern, blur_px=blur))


@pytest.mark.parametrize("noise", [0.3, 1.0, 1.4, 2.5])
def test_whether_a_swing_tells_the_blur(noise: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of periods alike: in most captures, or in few of them."""
    scene, found = prototype(0.34), []
    measure = decoder.measured_blur

    def watched(seen: Survey, lut: object, wanted: Plan, axis: AxisPlan) -> Blur | None:
        found.append(measure(seen, lut, wanted, axis))
        return found[-1]

    monkeypatch.setattr(decoder, "measured_blur", watched)
    surface, pattern = dent("flat", scene), scene.pattern
    shown = sequence("phase", pattern.rows, pattern.cols, steps=4, periods=(8.8, 8.58))
    for seed in range(CAPTURES):
        seen = capture(scene, surface, shown, noise=noise, seed=seed, renderer="numpy")
        decode(seen.frames, shown)
    told = sum(u is not None or v is not None for u, v in zip(found[::2], found[1::2], strict=True))
    view = view_of(scene, surface)
    predicted = [blur_told(view, shown, view.levels(noise), axis) for axis in "uv"]
    assert predicted[0] is None or predicted[1] is not None  # what one axis tells, the other one uses
    if told not in (CAPTURES // 2 - 1, CAPTURES // 2, CAPTURES // 2 + 1):  # else it is chance
        assert all((one is not None) == (told > CAPTURES // 2) for one in predicted)


def test_a_jump_of_the_border_table_is_not_taken_for_a_doubtful_blur() -> None:
    """A pixel on the border, whose shift the decoder looks up beside the place where periods part."""
    (case,) = drawn_cases(1, 70)
    scene = case.scene(108)
    surface = dent_from_text(case.dent, scene)
    pattern = scene.pattern
    offered = {one.text: one.sequence for one in candidates(pattern.rows, pattern.cols, case.frames)}
    shown = offered["ladder: 2 to 3 px, steps 3/8"]
    view = view_of(scene, surface)
    told = predict_axis(view, shown, case.noise, "u")
    errors = []
    for seed in range(CAPTURES):
        seen = capture(scene, surface, shown, noise=case.noise, seed=seed, renderer="numpy")
        found = decode(seen.frames, shown)
        errors.append(np.where(found.good, found.u - view.truth.u, np.nan)[10:-10, -1])
    assert told.bias[10:-10, -1] == pytest.approx(np.nanmean(errors, axis=0), abs=0.2)


@pytest.mark.parametrize(
    ("number", "text", "seed"),
    [
        (3, "ladder: 2 to 5 px, steps 8/8", 104),
        (3, "ladder: 2 to 5 px, steps 8/8", 110),
        (1, "ladder: 2 to 3 px, steps 7/7", 202),
        (1, "ladder: 2 to 3 px, steps 7/7", 204),
    ],
)
def test_few_pixels_that_do_not_settle_cost_no_other(number: int, text: str, seed: int) -> None:
    """Noise drives some away at the pattern's edge, once what is doubted is held in doubt at the latest, or
    leaves all within itself at the last step."""
    case = CASES[number]
    scene = case.scene(108)
    surface = dent_from_text(case.dent, scene)
    offered = candidates(scene.pattern.rows, scene.pattern.cols, case.frames)
    shown = next(c.sequence for c in offered if c.text == text)
    seen = capture(scene, surface, shown, noise=case.noise, seed=seed, renderer="numpy")
    height = reconstruct(decode(seen.frames, shown), scene)
    error = (height.z - trace(scene, surface).z) / height.sigma
    assert height.good.mean() > 0.94
    assert np.abs(error[height.good]).max() < 5
