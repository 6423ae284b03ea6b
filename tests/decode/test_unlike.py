"""Displays and cameras that do what no sequence says: told, and in sigma."""

from dataclasses import replace

import numpy as np
import pytest

from optolever.decode import Correspondence, decode
from optolever.patterns import Sequence, sequence

from .conftest import F64, Map, Shoot, scores, silent
from .light import camera

EXTENT = 150, 170
SHOWN = [
    sequence("gray+phase", *EXTENT),
    sequence("phase", *EXTENT, steps=6),
    sequence("phase", *EXTENT, steps=4, periods=(8.6, 10.244, 11.675)),
]
BEFORE = "frames hold a share of earlier ones"
BESIDE = "some frames, or parts of them, hold a share of earlier ones"


def lagging(light: F64, share: float) -> F64:
    """Frames that hold a share of the one before, as it was seen."""
    seen = [light[0]]
    for frame in light[1:]:
        seen.append((1 - share) * frame + share * seen[-1])
    return np.stack(seen)


def told(found: Correspondence) -> float:
    return sum(notice.size for notice in found.notices if notice.name == BEFORE)


@pytest.fixture(scope="module", params=SHOWN, ids=["gray+phase", "phase", "close"])
def shown(request: pytest.FixtureRequest) -> Sequence:
    out: Sequence = request.param
    return out


@pytest.fixture
def light(shown: Sequence, shoot: Shoot, smooth: Map) -> F64:
    return np.asarray(shoot(shown, *smooth, dtype=np.uint16, offset=10500.0, amplitude=9000.0) / 100.0)


@pytest.mark.daily(3)
@pytest.mark.parametrize("share", [0.0, 0.03, 0.1, 0.25, -0.1])
def test_what_a_slow_crystal_keeps_is_taken_off(
    share: float, shown: Sequence, light: F64, smooth: Map
) -> None:
    found = decode(camera(lagging(light, share), 0.7, 4), shown, on_cells=False)
    assert abs(told(found) - share) <= 0.02 * abs(share) + 0.002
    assert found.good.mean() > 0.95
    assert silent(found, *smooth) <= 1e-4
    # noise is least at a fringe's own frequency: sigma is up to 1 / (1 - share) too wide
    least = 0.9 * (1 - abs(share))
    assert least <= float(np.sqrt(np.mean(np.square(scores(found, *smooth))))) <= 1.15


@pytest.mark.daily(2)
@pytest.mark.parametrize(("share", "rows"), [(0.25, 75), (0.2, 100), (0.6, 0)])
def test_shares_that_are_not_taken_off_are_flagged_or_in_sigma(
    share: float, rows: int, shown: Sequence, light: F64, smooth: Map
) -> None:
    """In a part of the image alone, or larger than what is a frame of its own."""
    seen = lagging(light, share)
    seen[:, :rows] = light[:, :rows]
    found = decode(camera(seen, 0.7, 4), shown, on_cells=False)
    told = any(notice.name == BESIDE or "in part" in notice.name for notice in found.notices)
    assert told or rows == 100, "a sixth of the image is flagged without a word"
    assert silent(found, *smooth) <= 1e-4
    assert found.good.mean() > 0.5 or rows == 0, "what does not lag stays good; where all does by 0.6 none is"


@pytest.mark.daily(1)
def test_one_frame_exposed_longer_is_in_sigma(shown: Sequence, light: F64, smooth: Map) -> None:
    """Every third frame in turn; sigma is at most 4 times as wide as the errors."""
    kept = []
    for i in range(0, len(shown), 3):
        seen = light.copy()
        seen[i] *= 1.15
        found = decode(camera(seen, 0.7, 4), shown, on_cells=False, check=False)
        off = scores(found, *smooth)
        assert told(found) == 0
        kept.append(found.good.mean())
        if off.size:
            assert np.mean(np.abs(off) > 5) <= 0.01
            assert float(np.sqrt(np.mean(np.square(off)))) >= 1 / 4
    assert np.median(kept) > 0.5, kept


@pytest.mark.daily(1)
@pytest.mark.parametrize("size", [0.01, 0.03])
@pytest.mark.parametrize("shown", [sequence("phase", *EXTENT), SHOWN[2]], ids=["phase", "close"])
def test_bands_of_a_lamp_are_no_share_of_earlier_frames(
    shown: Sequence, size: float, shoot: Shoot, smooth: Map
) -> None:
    """A rolling shutter before a lamp that is dimmed by pulses: bands that lie elsewhere in every frame."""
    light = shoot(shown, *smooth, dtype=np.uint16, offset=10500.0, amplitude=9000.0) / 100.0
    rng = np.random.default_rng(5)
    turns = rng.uniform(1, 8) * np.arange(120)[:, None] / 120 + rng.random((len(shown), 1, 1))
    found = decode(camera(light * (1 + size * np.sin(2 * np.pi * turns)), 0.7, 4), shown, on_cells=False)
    assert told(found) == 0
    assert silent(found, *smooth) <= 1e-4
    assert found.good.mean() > 0.95


@pytest.mark.daily(2)
@pytest.mark.parametrize("share", [0.0, 0.02, 0.05])
@pytest.mark.parametrize(
    "shown",
    [
        sequence("gray+phase", *EXTENT),
        sequence("gray+phase", *EXTENT, inverses=True),
        sequence("phase", *EXTENT),
    ],
    ids=["white", "inverses", "phase"],
)
def test_a_second_reflection_shifts_all_pixels_and_sigma_says_so(
    shown: Sequence, share: float, shoot: Shoot, smooth: Map
) -> None:
    """23.3 and 11.7 px aside: one phase error in all pixels, at most the share of the light (radians)."""
    u, v = smooth

    def light(u: F64, v: F64) -> F64:
        return shoot(shown, u, v, dtype=np.uint16, offset=10500.0, amplitude=9000.0) / 100.0

    found = decode(camera(light(u, v) + share * light(u + 23.3, v + 11.7), 0.7, 4), shown, on_cells=False)
    shared = found.shared_noise
    shifts = (0.0, 0.0) if shared is None else (shared.shift_u, shared.shift_v)
    told = any(notice.name.startswith("neighbours share an error") for notice in found.notices)
    assert told == (share > 0)
    most = share * min(frame.period_px for frame in shown.frames if frame.period_px) / (2 * np.pi)
    for place, truth, shift in ((found.u, u, shifts[0]), (found.v, v, shifts[1])):
        assert abs(float(np.median((place - truth)[found.good]))) <= 3 * shift + 2e-3
        assert shift <= 2 * most
    assert found.good.mean() > 0.95


@pytest.mark.daily(2)
@pytest.mark.parametrize("gamma", [1.0, 1.4])
@pytest.mark.parametrize(
    "shown",
    [sequence("micro-phase", *EXTENT), sequence("phase", *EXTENT, steps=3, periods=(8.738, 8.057, 8.0))],
    ids=["micro-phase", "close"],
)
def test_what_fringes_of_three_steps_contradict_each_other_by_is_no_noise(
    shown: Sequence, gamma: float, shoot: Shoot, smooth: Map
) -> None:
    """Nothing but their mean levels says it."""
    frames = shoot(shown, *smooth, noise=0.7, gamma=gamma, offset=127.5, amplitude=120.0)
    found = decode(frames, shown, on_cells=False)
    assert any("contradict" in notice.name for notice in found.notices) == (gamma > 1)
    assert silent(found, *smooth) <= 1e-2 if gamma > 1 else 1e-4


CLOSE = sequence("phase", *EXTENT, steps=3, periods=(8.74, 8.06, 8.0))


def test_a_map_that_moves_from_period_to_period_is_in_sigma(shoot: Shoot, smooth: Map) -> None:
    """By 0.2 px in all; a place is one that the map had meanwhile, or next to it."""
    u, v = smooth
    moved = [0.2 * i / len(CLOSE) for i in range(len(CLOSE))]
    frames = np.stack([shoot(CLOSE, u + at, v + at, noise=0.7)[i] for i, at in enumerate(moved)])
    found = decode(frames, CLOSE, on_cells=False)
    assert any("contradict" in notice.name for notice in found.notices)
    assert found.good.mean() > 0.95
    mean_u, mean_v = (
        float(np.mean([moved[i] for i, one in enumerate(CLOSE.frames) if one.axis == axis])) for axis in "uv"
    )
    assert silent(found, u + mean_u, v + mean_v) <= 1e-4


@pytest.mark.daily(1)
@pytest.mark.parametrize("shown", [*SHOWN, CLOSE], ids=["gray+phase", "phase", "close", "three steps"])
def test_a_camera_that_moves_is_no_slope(shown: Sequence, shoot: Shoot, smooth: Map) -> None:
    """By 0.2 px in all: both axes see the map of the same moment, but for a third of a frame."""
    u, v = smooth
    moved = [0.2 * i / len(shown) for i in range(len(shown))]
    frames = np.stack(
        [
            shoot(replace(shown, frames=(one,)), u + at, v + at, noise=0.7, seed=i)[0]
            for i, (at, one) in enumerate(zip(moved, shown.frames, strict=True))
        ]
    )
    found = decode(frames, shown, on_cells=False)
    assert found.good.mean() > 0.95
    apart = float(np.mean((found.u - u - found.v + v)[found.good]))
    assert abs(apart) <= 0.2 / len(shown) * (0.5 if shown is CLOSE else 0.1)
