"""Drawn rigs: the same for the same number, what they cover, and a judge that notices what is wrong."""

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest

from lab.hard import hard_drawn
from lab.hard.found import found_area
from lab.hard.hard import hard_cases, run_hard
from lab.hard.hard_case import judged, pooled, run_case
from lab.hard.hard_drawn import rig_case, rig_of
from lab.hard.rigs import Rig
from optolever.decode import Correspondence, Flag
from optolever.patterns import sequence
from optolever.projector import AreaTrace, trace_area
from optolever.scene import Sensor, dent, load, resize

NUMBERS = range(0, 128, 2)


@lru_cache(maxsize=1)
def drawn() -> list[tuple[Rig, str, Sensor]]:
    return [rig_of(number) for number in NUMBERS]


def true_correspondence(area: AreaTrace, sigma: float = 0.01) -> Correspondence:
    """What a decoder that knows would say: partly lit pixels flagged."""
    u, v = area.mean()
    flags = np.where(area.visible, 0, int(Flag.OFF_PATTERN)).astype(np.uint16)
    return Correspondence(u, v, np.full(u.shape, sigma), np.full(u.shape, sigma), flags)


def test_a_number_is_a_rig() -> None:
    (first, code, sensor), (again, code_again, sensor_again) = drawn()[7], rig_of(NUMBERS[7])
    assert (first.kind, code, sensor) == (again.kind, code_again, sensor_again)
    assert first.scene == again.scene
    assert first.lighting == again.lighting
    assert first.surface.height(3.0, 4.0) == again.surface.height(3.0, 4.0)
    assert rig_case(14).label == hard_cases(drawn=1, first=14)[0].label


@pytest.fixture(scope="module")
def cut() -> AreaTrace:
    """A pattern that ends inside the image, in the middle of a pixel."""
    scene = resize(load("paper-simulation", exact=True), 40, 40)
    cells = replace(scene.pattern, cols=14)
    return trace_area(replace(scene, pattern=cells), dent("gaussian", scene))


def test_the_judge_takes_the_truth_and_nothing_else(cut: AreaTrace) -> None:
    case, code = rig_case(0), sequence("phase", 40, 14)
    right = true_correspondence(cut)
    assert judged(case, found_area(right, cut, code)).verdict == "good"
    wrong = replace(right, u=right.u + 0.051)
    result = judged(case, found_area(wrong, cut, code))
    assert result.verdict == "silent errors"
    assert result.silent == 1.0
    for count in (3, 4):
        few = right.v.copy()
        few[np.nonzero(cut.visible)[0][:count], np.nonzero(cut.visible)[1][:count]] += 5.0
        result = judged(case, found_area(replace(right, v=few), cut, code))
        assert (result.silent_count, result.fault) == (count, count > 3)


def test_a_wrong_decoder_fails_and_is_pooled(monkeypatch: pytest.MonkeyPatch) -> None:
    area = trace_area(*_scene_and_surface(14))

    def fake(share: float) -> None:
        right = true_correspondence(area)
        off = np.random.default_rng(3).random(right.u.shape) < share
        monkeypatch.setattr(
            hard_drawn, "decode", lambda *_: replace(right, u=np.where(off, 2.0 + right.u, right.u))
        )

    fake(0.0)
    good = run_case(rig_case(14))
    fake(0.02)
    (bad,) = run_hard([rig_case(14)])
    assert (good.verdict, bad.verdict) == ("good", "silent errors")
    figures = {one.name: one for one in pooled([good, bad])}
    failed, silent = figures["rigs failed"], figures["silent errors on rigs, of unflagged pixels"]
    assert (failed.value, failed.count, failed.met) == (0.5, 2, False)
    assert silent.value == pytest.approx(0.01, rel=0.3)
    assert not silent.met
    assert all(one.met for one in pooled([good]))
    assert pooled([]) == []


def _scene_and_surface(number: int) -> tuple[object, object]:
    rig, _, _ = rig_of(number)
    return rig.scene, rig.surface
