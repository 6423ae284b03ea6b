"""Every flag provoked, and nothing wrong that is not flagged."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from optolever import InputError
from optolever.decode import Correspondence, Flag, Response, decode
from optolever.patterns import Frame, Sequence, sequence, sequence_from_text
from optolever.samples.metrics import rms

from .conftest import Map, Shoot, scores, silent
from .light import camera

GRAY_PHASE = sequence("gray+phase", 150, 170)


def share(found: Correspondence, flag: Flag, where: Any = ...) -> float:
    return float(((found.flags & flag) > 0)[where].mean())


@pytest.mark.daily(12)
@pytest.mark.parametrize("name", ["gray", "binary", "phase", "gray+phase", "stripe"])
@pytest.mark.parametrize("grey", [0, 3, 128, 255])
def test_flat_captures_are_results_with_flags(name: str, grey: int) -> None:
    shown = sequence(name, 60, 60)
    frames = np.full((len(shown), 20, 30), grey, np.uint8)
    found = decode(frames, shown)
    assert not found.good.any()
    assert share(found, Flag.DARK if grey < 10 and name != "stripe" else Flag.LOW_CONTRAST) == 1


def test_dark_part(shoot: Shoot, smooth: Map) -> None:
    light = np.where(np.arange(140) < 40, 0.5, 100.0)[None, :] * np.ones((120, 1))
    found = decode(shoot(GRAY_PHASE, *smooth, noise=1.0, amplitude=light, offset=light + 3), GRAY_PHASE)
    assert share(found, Flag.DARK, np.s_[:, :39]) > 0.99
    assert share(found, Flag.LOW_CONTRAST, np.s_[:, :39]) > 0.99
    assert found.good[:, 42:].mean() > 0.99
    assert silent(found, *smooth, least=0.05) <= 1e-4


def test_low_contrast_under_bright_light(shoot: Shoot, smooth: Map) -> None:
    found = decode(shoot(GRAY_PHASE, *smooth, noise=3.0, amplitude=6.0, offset=150), GRAY_PHASE)
    assert share(found, Flag.LOW_CONTRAST) > 0.95
    assert share(found, Flag.DARK) == 0
    assert silent(found, *smooth, least=0.05) <= 1e-4


def test_clipped_samples_are_left_out(shoot: Shoot, smooth: Map) -> None:
    """Clipping at 255 of 300 with 8 steps: the error stays within 1.5 times that of the unclipped fringe."""
    shown = sequence("gray+phase", 150, 170, steps=8)
    clipped = decode(shoot(shown, *smooth, noise=1.0, amplitude=145, offset=155), shown, on_cells=False)
    whole = decode(
        shoot(shown, *smooth, noise=1.0, amplitude=145, offset=155, dtype=np.uint16), shown, on_cells=False
    )
    assert clipped.good.mean() > 0.98
    errors = [float(np.std((found.u - smooth[0])[found.good])) for found in (clipped, whole)]
    assert errors[0] < 1.5 * errors[1]
    assert rms(scores(clipped, smooth[0])) == pytest.approx(1, abs=0.15)
    assert silent(clipped, *smooth, least=0.05) <= 1e-4


@pytest.mark.daily(2)
@pytest.mark.parametrize("bits", [8, 10, 12, 14])
def test_clipping_of_cameras_that_use_the_upper_of_sixteen_bits(bits: int, shoot: Shoot, smooth: Map) -> None:
    """Their largest level ends in zeros, as 65520 of 12 bits; but for scale nothing changes."""
    unit = 2 ** (bits - 8)
    light = {"noise": 1.0 * unit, "amplitude": 145.0 * unit, "offset": 155.0 * unit}
    frames = shoot(GRAY_PHASE, *smooth, top=256 * unit - 1, dtype=np.uint16, **light)
    lower, upper = (decode(each, GRAY_PHASE) for each in (frames, frames << (16 - bits)))
    assert (lower.flags == upper.flags).mean() > 0.99
    assert np.median((upper.sigma_u / lower.sigma_u)[lower.good]) == pytest.approx(1, abs=0.01)


def test_saturated_where_too_few_samples_are_left(shoot: Shoot, smooth: Map) -> None:
    found = decode(shoot(GRAY_PHASE, *smooth, noise=1.0, amplitude=150, offset=320), GRAY_PHASE)
    assert share(found, Flag.SATURATED) > 0.9
    assert silent(found, *smooth, least=0.05) <= 1e-4


def test_off_pattern(shoot: Shoot) -> None:
    col = np.arange(-30.0, 110.0)[None, :] * np.ones((40, 1))
    shown = sequence("phase", 60, 80, axes="u")
    found = decode(shoot(shown, col, col, noise=1.0), shown, on_cells=False)
    assert share(found, Flag.OFF_PATTERN, np.s_[:, 34:106]) == 0
    outside = (col > -4.5) & (col < -2) | (col > 81.5) & (col < 84)
    assert share(found, Flag.OFF_PATTERN, outside) > 0.95
    gray = sequence("gray", 60, 80, axes="u")
    found = decode(shoot(gray, col + 40, col + 40), gray)
    assert share(found, Flag.OFF_PATTERN, np.s_[:, -20:]) == 1


def test_order_doubtful_where_bits_are_weak(shoot: Shoot, smooth: Map) -> None:
    """Noise near the contrast: orders fail, and those that do are flagged."""
    frames = shoot(GRAY_PHASE, *smooth, noise=14.0, amplitude=60.0)
    found = decode(frames, GRAY_PHASE, on_cells=False)
    gross = np.abs(found.u - smooth[0]) > 4
    assert share(found, Flag.ORDER_DOUBTFUL) > 0.02
    assert (gross & found.good).mean() <= 1e-4
    assert silent(found, *smooth, least=0.05) <= 1e-4


def test_hot_pixels(shoot: Shoot, smooth: Map) -> None:
    """Stuck pixels hold one value in every frame; the decoder must not take them for a place."""
    frames = shoot(GRAY_PHASE, *smooth, noise=1.0)
    rng = np.random.default_rng(3)
    row, col = rng.integers(0, 120, 200), rng.integers(0, 140, 200)
    frames[:, row, col] = rng.integers(0, 256, 200)
    found = decode(frames, GRAY_PHASE, on_cells=False)
    assert not found.good[row, col].any()
    assert silent(found, *smooth, least=0.05) <= 1e-4


def test_outlier(shoot: Shoot, smooth: Map) -> None:
    """A pixel that shows another place, consistently in all frames."""
    frames = shoot(GRAY_PHASE, *smooth, noise=1.0)
    frames[:, 60, 70] = frames[:, 30, 20]
    found = decode(frames, GRAY_PHASE, on_cells=False)
    assert found.flags[60, 70] & Flag.OUTLIER
    assert share(found, Flag.OUTLIER) <= 2 / found.flags.size


def test_gamma_is_no_silent_error_and_the_response_mends_it(shoot: Shoot, smooth: Map) -> None:
    light = {"noise": 0.7, "offset": 127.5, "amplitude": 127.5}
    bent, straight = (shoot(GRAY_PHASE, *smooth, gamma=gamma, **light) for gamma in (2.2, 1.0))
    raw, plain = (decode(one, GRAY_PHASE, on_cells=False) for one in (bent, straight))
    mended = decode(bent, GRAY_PHASE, response=Response.from_gamma(2.2, blur=0.0), on_cells=False)
    for found in (raw, mended):
        assert silent(found, *smooth, least=0.05) <= 2e-4
    assert rms(scores(raw, *smooth)) > 0.4
    errors = [float(np.std((found.u - smooth[0])[found.good])) for found in (mended, plain)]
    assert errors[0] <= 1.5 * errors[1]


def test_flicker_is_no_silent_error(shoot: Shoot, smooth: Map) -> None:
    """Ambient light that flickers by 5 levels from frame to frame; in step with the shifts it is a fringe."""
    shown = sequence("gray+phase", 150, 170, steps=8)
    still, rng, wrong = shoot(shown, *smooth, noise=1.0).astype(np.float64), np.random.default_rng(0), 0
    for _ in range(10):
        flicker = 5 * np.sin(rng.uniform(0.3, 3) * np.arange(len(shown)) + rng.uniform(0, 6))
        found = decode(camera(still + flicker[:, None, None]), shown, on_cells=False)
        wrong += silent(found, *smooth, least=0.05) > 1e-4
    assert wrong <= 2  # 6 of 40 draws


@pytest.mark.parametrize("name", ["gray+phase", "phase", "phase:periods=9/10/11,steps=3"])
def test_pixels_that_are_no_numbers_are_invalid(name: str, shoot: Shoot, smooth: Map) -> None:
    """Close periods read the table of their orders by the phase."""
    shown = sequence_from_text(name, 150, 170)
    frames = shoot(shown, *smooth, noise=1.0).astype(np.float64)
    lost = np.random.default_rng(0).random(smooth[0].shape) < 0.005
    frames[3, lost] = np.where(np.arange(lost.sum()) % 2, np.nan, np.inf)
    found = decode(frames, shown)
    assert (found.flags[lost] & Flag.INVALID.value).all()
    assert found.good.mean() > 0.7
    assert silent(found, *smooth, least=2.0) < 0.01


def test_one_period_alone_is_never_called_good(shoot: Shoot, smooth: Map) -> None:
    shown = sequence("phase", 150, 170, periods=20)
    assert not decode(shoot(shown, *smooth), shown).good.any()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda frames: frames[:-1], "21 frames, sequence gray.phase describes 22"),
        (lambda frames: frames[0], "shape"),
        (lambda frames: frames[:, :0], "shape"),
        (lambda frames: frames.astype(np.int32) - 1, "int32 from -1 to -1"),
        (lambda frames: frames.astype(np.complex64), "complex64"),
        (lambda frames: np.full(frames.shape, np.nan), "no pixel is finite"),
    ],
)
def test_bad_frames(change: Callable[[NDArray[Any]], NDArray[Any]], message: str) -> None:
    with pytest.raises(InputError, match=message):
        decode(change(np.zeros((22, 20, 30), np.uint8)), GRAY_PHASE)


@pytest.mark.parametrize(
    ("frames", "message"),
    [
        ((Frame("white"),), "none of them encodes"),
        (
            (Frame("gray", "u", bit=2), Frame("gray", "u", bit=0), Frame("white"), Frame("black")),
            "bit 1 on u",
        ),
        ((Frame("gray", "u", bit=0), Frame("gray", "u", bit=0)), "described twice"),
        ((Frame("crossed", period_px=9.0),), "read by live"),
        ((Frame("stripe", "u", width_px=9.0, at_u=1.0),), "1 stripes"),
        (
            tuple(Frame("stripe", "u", width_px=9.0, at_u=float(k)) for k in (1, 2, 2, 3, 4)),
            "different places",
        ),
        ((Frame("gray", "u", bit=0), Frame("binary", "u", bit=1)), "mixes kind"),
    ],
)
def test_bad_sequences(frames: tuple[Frame, ...], message: str) -> None:
    shown = Sequence(frames, 40, 60)
    with pytest.raises(InputError, match=message):
        decode(np.zeros((len(frames), 4, 4), np.uint8), shown)


@pytest.mark.parametrize(("name", "value"), [("noise", -1.0), ("gain", float("nan")), ("white_level", 0.0)])
def test_bad_arguments(name: str, value: float) -> None:
    with pytest.raises(InputError, match=name):
        decode(np.zeros((22, 4, 4), np.uint8), GRAY_PHASE, **{name: value})
