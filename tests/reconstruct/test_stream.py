"""HeightStream: a growing dent, frame by frame, against the full solve."""

from dataclasses import replace

import numpy as np
import pytest

from optolever import InputError
from optolever.reconstruct import HeightStream, reconstruct
from optolever.scene import dent_from_text as dent
from optolever.scene import trace

PEAKS = (1.0, 1.02, 1.05, 1.09)


@pytest.fixture(scope="module")
def frames(exact, noisy):
    scene, _, _ = exact("paper-simulation", "flat", 96, 128)
    traces = [trace(scene, dent(f"raised-cosine:peak={peak}", scene)) for peak in PEAKS]
    return scene, [noisy(truth, noise=0.02, seed=k) for k, truth in enumerate(traces)]


def test_every_frame_within_a_tenth_of_sigma(frames) -> None:
    scene, correspondences = frames
    stream = HeightStream(scene)
    for k, correspondence in enumerate(correspondences):
        if k == 2:  # a pixel drops out, another comes in flagged before
            flags = correspondence.flags.copy()
            flags[30, 40] = 8
            correspondence = replace(correspondence, flags=flags)
        height, full = stream.update(correspondence), reconstruct(correspondence, scene)
        np.testing.assert_array_equal(height.flags, full.flags)
        good = full.good
        off = np.abs(height.z - full.z)[good] / full.sigma[good]
        assert np.sqrt(np.mean(off**2)) < 0.02
        assert np.quantile(off, 0.999) < 0.1
        assert np.mean(np.abs(height.sigma[good] / full.sigma[good] - 1) > 0.1) < 0.01


def test_a_jump_and_a_new_mask_are_solved_in_full(frames, exact, noisy, cut) -> None:
    scene, correspondences = frames
    stream = HeightStream(scene)
    stream.update(correspondences[0])
    _, truth, _ = exact("paper-simulation", "needle", 96, 128)
    jump = noisy(truth, noise=0.02, seed=9)
    keep = np.ones((96, 128), dtype=bool)
    keep[40:60, 40:60] = False
    for correspondence in (jump, cut(jump, keep)):
        height, full = stream.update(correspondence), reconstruct(correspondence, scene)
        good = full.good & height.good
        assert good.sum() > 0.99 * full.good.sum()
        assert np.max(np.abs(height.z - full.z)[good] / full.sigma[good]) < 0.1


@pytest.mark.daily(2)
@pytest.mark.parametrize("what", ["wrong pixels", "noisier", "contradictory", "uncovered"])
def test_what_the_last_frame_does_not_bear_out_is_solved_in_full(exact, noisy, what: str) -> None:
    """Beside a crease, whose doubts the first frame holds."""
    scene, truth, _ = exact("prism48", "needle", 96, 128)
    first, same, now = (noisy(truth, noise=0.02, seed=k) for k in range(3))
    if what == "wrong pixels":
        wrong = np.random.default_rng(4).choice(truth.u.size, 20, replace=False)
        now.u.flat[wrong] += 2.0
    elif what == "noisier":
        now = noisy(truth, noise=0.15, seed=2)
    elif what == "contradictory":
        now = replace(now, v=now.v + 0.1 * np.linspace(0, 1, 96)[:, None] * np.linspace(0, 1, 128))
    else:
        flags = first.flags.copy()
        flags[70:, :] = 8
        first, same = replace(first, flags=flags), replace(same, flags=flags)
    stream = HeightStream(scene)
    stream.update(first)
    assert stream.update(same).diagnostics.curl is None  # goes on from the last
    height, full = stream.update(now), reconstruct(now, scene)
    assert height.diagnostics.curl is not None
    np.testing.assert_array_equal(height.good, full.good)
    np.testing.assert_allclose(height.sigma[full.good], full.sigma[full.good], rtol=1e-2)
    assert [one.name for one in height.notices] == [one.name for one in full.notices]


def test_refresh(frames) -> None:
    scene, correspondences = frames
    stream = HeightStream(scene, refresh=2)
    curls = [stream.update(c).diagnostics.curl for c in correspondences]
    assert [curl is None for curl in curls] == [False, True, False, True]


def test_bad_input(frames, exact) -> None:
    scene, correspondences = frames
    stream = HeightStream(scene)
    stream.update(correspondences[0])
    _, _, other = exact("paper-simulation", "flat", 40, 48)
    with pytest.raises(InputError):
        stream.update(other)
