"""Ring: a height a frame, against the decode and the solve of whole captures."""

import numpy as np
import pytest

from optolever import InputError
from optolever.decode import decode
from optolever.live import Ring
from optolever.patterns import sequence
from optolever.projector import capture
from optolever.reconstruct import reconstruct
from optolever.scene import dent, load, resize

RIG = resize(load("prism48", exact=True), 96, 128)
SHOWN = sequence("phase", RIG.pattern.rows, RIG.pattern.cols, steps=3)
DEPTHS = (0.05, 0.05, 0.08)


@pytest.fixture(scope="module")
def captures():
    surfaces = [dent("gaussian", RIG, peak=peak, sigma=6.0) for peak in DEPTHS]
    return [
        capture(RIG, surface, SHOWN, noise=1.0, seed=seed, renderer="numpy").frames
        for seed, surface in enumerate(surfaces)
    ]


def test_every_frame_is_a_height_and_a_notice_says_where_they_are_of_two_moments(captures) -> None:
    ring = Ring(RIG, SHOWN)
    full = [reconstruct(decode(frames, SHOWN), RIG) for frames in captures]
    assert [ring.update(frame) for frame in captures[0][:-1]] == [None] * (len(SHOWN) - 1)
    ring.update(captures[0][-1])
    for before, after in ((0, 1), (1, 2)):
        for frame in captures[after]:
            height = ring.update(frame)
            assert height is not None
            both = full[before].z, full[after].z
            beyond = height.z < np.minimum(*both) - 5 * height.sigma
            beyond |= height.z > np.maximum(*both) + 5 * height.sigma
            assert height.notices or beyond[height.good].mean() <= 1e-3
        for frame in captures[after]:  # a frame that is like the one before it ends the notice
            height = ring.update(frame)
        assert not [one for one in height.notices if "round before" in one.name]
        both = height.good & full[after].good
        assert both.mean() > 0.95
        assert np.abs((height.z - full[after].z)[both] / height.sigma[both]).max() < 1


def test_frames_by_number_in_any_order(captures) -> None:
    ring = Ring(RIG, SHOWN)
    for number in np.random.default_rng(0).permutation(len(SHOWN)).tolist():
        height = ring.update(captures[0][number], number)
    assert height is not None
    assert ring.correspondence is not None
    np.testing.assert_array_equal(ring.correspondence.u, decode(captures[0], SHOWN).u)


def test_what_is_no_frame_of_the_ring_is_refused(captures) -> None:
    ring = Ring(RIG, SHOWN)
    with pytest.raises(InputError, match="number is 18, must be 0 to 17"):
        ring.update(captures[0][0], 18)
    ring.update(captures[0][0])
    with pytest.raises(InputError, match=r"frame is uint8 .5, 5., must be uint8 .96, 128. as the last"):
        ring.update(np.zeros((5, 5), np.uint8))
