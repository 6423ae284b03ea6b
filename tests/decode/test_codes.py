"""Every code, from ideal frames: coordinates right, whatever the frames' order and the camera's bits."""

from typing import Any

import numpy as np
import pytest

from optolever.decode import decode
from optolever.patterns import Frame, Sequence, sequence

from .conftest import Map, Shoot

CODES: list[tuple[str, dict[str, Any], float]] = [
    ("gray", {}, 0.5),
    ("gray", {"inverses": False}, 0.5),
    ("gray", {"references": False}, 0.5),
    ("gray", {"cell": 3.0}, 1.5),
    ("binary", {}, 0.5),
    ("phase", {}, 0.02),
    ("phase", {"steps": 3}, 0.02),
    ("phase", {"steps": 5, "periods": 200}, 0.3),
    ("phase", {"counts": (9, 10, 11)}, 0.05),
    ("phase", {"periods": (13.5, 11.7)}, 0.03),
    ("gray+phase", {}, 0.02),
    ("gray+phase", {"inverses": True, "steps": 8, "period": 16}, 0.02),
]


@pytest.mark.daily(12)
@pytest.mark.parametrize(("name", "params", "limit"), CODES)
@pytest.mark.parametrize(("dtype", "scale"), [(np.uint8, 1), (np.uint16, 16)])
def test_ideal_frames(
    shoot: Shoot, smooth: Map, name: str, params: dict[str, Any], limit: float, dtype: type, scale: int
) -> None:
    shown = sequence(name, 150, 170, **params)
    frames = shoot(
        shown, *smooth, dtype=dtype, offset=110 * scale, amplitude=100 * scale, top=256 * scale - 1
    )
    found = decode(frames, shown, on_cells=False)
    assert found.good.mean() > 0.995
    for coord, truth, sigma in zip((found.u, found.v), smooth, (found.sigma_u, found.sigma_v), strict=True):
        assert np.abs(coord - truth)[found.good].max() <= limit + 1e-3
        assert sigma[found.good].min() >= 0.001 - 1e-6


@pytest.mark.parametrize(
    ("name", "params"), [("binary", {"references": False}), ("gray+phase", {"inverses": True})]
)
def test_bytes_are_decoded_as_wider_numbers_are(
    shoot: Shoot, smooth: Map, name: str, params: dict[str, Any]
) -> None:
    """Faint and clipped stripes, and a bit that shows what the one before it shows."""
    shown = sequence(name, 150, 170, **params)
    col = np.arange(smooth[0].shape[1])
    light = np.where(col % 50 < 8, 2.0, 90.0)
    light[(col > 60) & (col < 70)] = 150.0
    frames = shoot(shown, *smooth, noise=15.0, offset=light + 10, amplitude=light)
    frames[3, 40:44, 20:30] = frames[5, 40:44, 20:30]
    one, two = decode(frames, shown), decode(frames.astype(np.uint16), shown, white_level=255)
    others = [decode(frames.astype(kind), shown, white_level=255) for kind in (np.int16, np.int64, ">u2")]
    assert 0.05 < np.mean(one.flags != 0) < 0.95
    for field in ("u", "v", "sigma_u", "sigma_v", "flags", "amplitude", "offset"):
        for other in (two, *others):
            np.testing.assert_array_equal(getattr(one, field), getattr(other, field))
    # probabilities of both axes are joined pixel by pixel, or in vectors, which round in other places
    np.testing.assert_allclose(one.order_error, two.order_error, rtol=1e-6)


@pytest.mark.daily(3)
@pytest.mark.parametrize("axes", ["u", "v"])
@pytest.mark.parametrize("name", ["gray", "phase", "gray+phase"])
def test_axis_that_is_not_encoded_is_no_fault(shoot: Shoot, smooth: Map, name: str, axes: str) -> None:
    shown = sequence(name, 150, 170, axes=axes)
    found = decode(shoot(shown, *smooth), shown)
    missing, sigma = (found.v, found.sigma_v) if axes == "u" else (found.u, found.sigma_u)
    assert np.isnan(missing).all()
    assert np.isinf(sigma).all()
    assert found.good.mean() > 0.99


def test_foreign_polarities_and_missing_inverses(shoot: Shoot, smooth: Map) -> None:
    """Some bits only inverted, some only plain, an inverted black for white, fringes with odd shifts."""
    shown = sequence("gray+phase", 150, 170, inverses=True)
    kept = [Frame("black", inverted=True), Frame("black")]
    for frame in shown.frames[2:]:
        if (
            frame.kind == "gray"
            and (frame.bit or 0) % 3 != 2
            and frame.inverted == ((frame.bit or 0) % 3 == 1)
        ):
            continue
        kept.append(frame)
    for shift in (0.3, 1.9, 4.0, 5.5, 2.2):
        kept.append(Frame("phase", "u", period_px=8.0, shift=shift))
    foreign = Sequence(tuple(kept), 150, 170)
    found = decode(shoot(foreign, *smooth), foreign, on_cells=False)
    assert found.good.mean() > 0.99
    assert np.abs(found.u - smooth[0])[found.good].max() < 0.02


def test_folded_map_is_decoded_on_both_sides(shoot: Shoot) -> None:
    """Where the map turns back, a per-pixel code goes on; no spatial step may flag or mend it."""
    col = np.arange(400.0)[None, :] * np.ones((40, 1))
    u = 100 + 80 * np.cos(col / 60)
    v = 5 + np.arange(40.0)[:, None] * np.ones((1, 400))
    shown = sequence("gray+phase", 60, 256)
    found = decode(shoot(shown, u, v, noise=1.0), shown, on_cells=False)
    assert found.good.mean() > 0.999
    assert np.abs(found.u - u)[found.good].max() < 0.1


def test_cells_as_large_as_a_period(shoot: Shoot, smooth: Map) -> None:
    """Where two orders fit the neighbours choose; one spot of wrong bits moves no place by a period."""
    phases, bits = sequence("gray+phase", 150, 170, period=16), sequence("gray", 150, 170, cell=16.0)
    kept = (
        [one for one in phases.frames if one.bit is None],
        [one for one in bits.frames if one.bit is not None],
    )
    shown = Sequence((*kept[0], *kept[1]), 150, 170)
    frames = shoot(shown, *smooth)
    frames[len(kept[0]) : len(kept[0]) + 3, 40:43, 40:43] = 128
    found = decode(frames, shown, on_cells=False)
    assert found.good.mean() > 0.995
    for coord, truth in zip((found.u, found.v), smooth, strict=True):
        assert np.abs(coord - truth)[found.good].max() < 1
