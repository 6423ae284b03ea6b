"""Sequences against the definitions of their codes."""

from typing import Any

import cv2
import numpy as np
import pytest

from optolever import InputError
from optolever.patterns import (
    Frame,
    Sequence,
    code_words,
    lattice_lines,
    sequence,
    sequence_from_text,
    sequence_names,
)

NAMES = sequence_names()


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize(("rows", "cols"), [(37, 53), (1, 1), (5, 300)])
def test_render_is_the_product_or_mean_of_the_tables(name: str, rows: int, cols: int) -> None:
    shown = sequence(name, rows, cols)
    images = shown.render()
    assert images.shape == shown.shape == (len(shown), rows, cols)
    assert images.dtype == np.uint8
    along_u, along_v = (table.astype(int) for table in shown.tables())
    for image, frame, u, v in zip(images, shown.frames, along_u, along_v, strict=True):
        mean = (u[None, :] + v[:, None] + 1) // 2
        product = (u[None, :] * v[:, None] + 127) // 255
        np.testing.assert_array_equal(image, mean if frame.combine == "mean" else product)


@pytest.mark.parametrize("name", NAMES)
def test_plain_form_comes_back(name: str) -> None:
    shown = sequence(name, 21, 34)
    assert Sequence.from_dict(shown.to_dict()) == shown


@pytest.mark.parametrize("name", [name for name in NAMES if "gray" in name or name == "binary"])
def test_every_code_tells_all_cells_apart(name: str) -> None:
    params = {} if name == "gray+phase" else {"references": False}
    shown = sequence(name, 300, 301, **params)
    for table in shown.tables():
        assert len(np.unique(table, axis=1).T) == table.shape[1]


def test_inverse_is_the_complement_along_its_axis_only() -> None:
    plain, inverse = Frame("gray", "v", bit=1), Frame("gray", "v", bit=1, inverted=True)
    (u, v), (inverse_u, inverse_v) = plain.tables(20, 30), inverse.tables(20, 30)
    np.testing.assert_array_equal(v + inverse_v, 255)
    np.testing.assert_array_equal(u, 255)
    np.testing.assert_array_equal(inverse_u, 255)


def test_fringe_levels_follow_the_formula() -> None:
    frame = Frame("phase", "u", period_px=13.7, shift=0.4)
    level = 127.5 * (1 + np.cos(2 * np.pi * np.arange(90) / 13.7 - 0.4))
    assert np.abs(frame.tables(3, 90)[0] - level).max() <= 0.5


def test_uncovered_levels_of_a_lattice_add_up_to_its_lines() -> None:
    frame = Frame("lattice", period_px=12.5, width_px=3.3, offset_px=6.2)
    lines = lattice_lines(frame, 100)
    np.testing.assert_allclose(lines, 6.2 + 12.5 * np.arange(8))
    dark = 1 - frame.tables(100, 100)[0] / 255
    assert dark.sum() == pytest.approx(8 * 3.3, abs=8 * 5 * 0.5 / 255)
    centroid = (dark[:13] * np.arange(13)).sum() / dark[:13].sum()
    assert centroid == pytest.approx(6.2, abs=0.01)


def test_swept_stripe_lights_every_place_equally() -> None:
    total = sequence("stripe", 40, 60, axes="u", step=3).tables()[0].astype(float).sum(axis=0)
    assert np.ptp(total) <= 4


@pytest.mark.parametrize("extent", [(150, 170), (48, 640), (64, 64)])
@pytest.mark.parametrize(
    ("name", "params"),
    [
        ("phase", {}),
        ("phase", {"steps": 3, "periods": (8.74, 8.06, 8)}),
        ("phase", {"steps": 6}),
        ("gray+phase", {"inverses": True}),
        ("micro-phase", {}),
    ],
)
def test_axes_are_shown_at_the_same_time(name: str, params: dict[str, Any], extent: tuple[int, int]) -> None:
    """The finest of both: their mean times are a frame apart at most, of even numbers not at all."""
    shown = sequence(name, *extent, **params)
    fine = [i for i, frame in enumerate(shown.frames) if (frame.period_px or 99) < 24]
    of_u, of_v = ([i for i in fine if shown.frames[i].axis == axis] for axis in "uv")
    assert len(of_u) == len(of_v) > 1
    apart = abs(np.mean(of_u) - np.mean(of_v))
    assert apart == 0 if len(of_u) % 2 == 0 else apart <= 3 / len(of_u)


@pytest.mark.parametrize("axes", ["u", "uv"])
@pytest.mark.parametrize("steps", [4, 6, 8])
def test_opposite_shifts_are_symmetrical_in_time(steps: int, axes: str) -> None:
    """Only so a phase that grows from frame to frame is told as its mean: no harmonic of it is left."""
    shown = sequence("phase", 40, 60, axes=axes, steps=steps, periods=16.0)
    time = {(one.axis, one.shift): i for i, one in enumerate(shown.frames)}
    for axis in axes:
        phases = 0.001 * np.array([time[axis, one.shift] for one in shown.frames if one.axis == axis])
        shifts = np.array([one.shift for one in shown.frames if one.axis == axis])
        for phase in np.linspace(0, 6, 7):
            told = np.angle(np.cos(phase + phases - shifts) @ np.exp(1j * shifts) * np.exp(-1j * phase))
            assert told == pytest.approx(phases.mean(), abs=1e-5)


def test_png_export(tmp_path_factory: pytest.TempPathFactory) -> None:
    folder = tmp_path_factory.mktemp("png") / "shown"
    shown = sequence("phase", 30, 40, axes="v", periods=10)
    shown.save_png(folder)
    for k, image in enumerate(shown.render()):
        np.testing.assert_array_equal(cv2.imread(str(folder / f"{k:03d}.png"), cv2.IMREAD_UNCHANGED), image)
    with pytest.raises(InputError, match="nothing is written over"):
        shown.save_png(folder)


def test_text_form() -> None:
    shown = sequence_from_text("phase:steps=5,periods=9/10.5,axes=u", 30, 40)
    assert shown == sequence("phase", 30, 40, steps=5, periods=(9, 10.5), axes="u")
    assert not any(frame.inverted for frame in sequence_from_text("gray:inverses=false", 8, 8).frames)


def test_complementary_gray() -> None:
    """Coarse bits number the periods from wrap to wrap, the finest one has its edges amid them."""
    shown = sequence_from_text("gray+phase:cells=half,period=10,axes=u", 20, 63)
    bits = {
        frame.bit: shown.render()[i, 0] > 127 for i, frame in enumerate(shown.frames) if frame.kind == "gray"
    }
    period = (np.arange(63) + 5) // 10
    for bit, bright in bits.items():
        if bit:
            np.testing.assert_array_equal(bright, (period ^ period >> 1) >> (bit - 1) & 1)
    np.testing.assert_array_equal(np.flatnonzero(np.diff(bits[0].astype(int))), np.arange(9, 63, 10))
    assert max(bits) == 3


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("greycode", "name is 'greycode'"),
        ("phase:step=3", "unknown parameter 'step'"),
        ("phase:steps=2", "steps is 2"),
        ("phase:steps", "must be name=value"),
        ("gray:axes=w", "axes is 'w'"),
        ("phase:periods=16/0", r"periods is \(16, 0\)"),
        ("phase:periods=1e999", "periods is inf"),
        ("phase:counts=false", "counts is False"),
        ("phase:steps=1000000", "steps is 1000000"),
        ("phase:steps=3.5", "steps is 3.5"),
        ("phase:steps=4,steps=5", "steps is given twice"),
        ("phase:steps=x", "sequence phase"),
        ("stripe:step=1e-9", "step is 1e-09"),
        ("ramp:count=100000000", "count is 100000000"),
        ("gray:inverses=0.5", "inverses is 0.5"),
        ("gray+phase:period=-8", "period is -8"),
        ("gray+phase:cells=whole", "cells is 'whole', must be 'start' or 'half'"),
        ("gray:inverses=false,references=false", "both false"),
    ],
)
def test_bad_text_is_one_line(text: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        sequence_from_text(text, 30, 40)


@pytest.mark.parametrize(
    ("plain", "message"),
    [
        ({"kind": "grey"}, "kind is 'grey'"),
        ({"axis": "u"}, "kind is missing"),
        ({"kind": "gray", "axis": "u"}, "bit is missing"),
        ({"kind": "gray", "axis": "w", "bit": 1}, "axis is 'w'"),
        ({"kind": "gray", "axis": "u", "bit": 1.5}, "bit is 1.5, must be int"),
        ({"kind": "gray", "axis": "u", "bit": 1, "colour": 3}, "unknown field 'colour'"),
        ({"kind": "white", "exposure": 4.0}, "exposure is 4.0, one alone is decoded"),
        ({"kind": "phase", "axis": "u", "period_px": float("nan"), "shift": 0.0}, "period_px is nan"),
        ({"kind": "stripe", "axis": "u", "width_px": 3.0}, "at_u is missing"),
        ({"kind": "levels", "axis": "u", "levels": [1, 300]}, "level is 300"),
        ({"kind": "white", "inverted": "yes"}, "inverted is 'yes'"),
        ({"rows": 4, "cols": 4, "frames": []}, "frames is empty"),
        ({"rows": 0, "cols": 4, "frames": [{"kind": "white"}]}, "rows is 0"),
        ({"rows": 4.0, "cols": 4, "frames": [{"kind": "white"}]}, "rows is 4.0"),
        ({"rows": 4, "cols": 4, "frames": [3]}, "frames is"),
        ({"rows": 4, "cols": 4, "size": 1, "frames": [{"kind": "white"}]}, "unknown field 'size'"),
    ],
)
def test_bad_description_names_the_field(plain: dict[str, object], message: str) -> None:
    """Of a frame, and of a sequence."""
    whole = plain if "frames" in plain else {"rows": 4, "cols": 4, "frames": [plain]}
    with pytest.raises(InputError, match=message):
        Sequence.from_dict(whole, "capture.toml")


@pytest.mark.parametrize("bits", range(1, 17))
@pytest.mark.parametrize("code", ["gray", "long-run-gray"])
def test_gray_codes_have_neighbours_of_one_bit(code: str, bits: int) -> None:
    """Every word once, neighbours differ in one bit, which of long runs does not change again soon."""
    words = code_words(code, np.arange(1 << bits))
    assert sorted(words.tolist()) == list(range(1 << bits))
    changes = words[1:] ^ words[:-1]
    assert ((changes & (changes - 1)) == 0).all()
    least = {1: 1, 5: 4, 6: 4, 7: 5, 8: 5, 9: 5}.get(bits, 2 if bits < 5 else 7)
    least = least if code == "long-run-gray" else 2
    for bit in range(bits):
        edges = np.flatnonzero(changes == 1 << bit)
        assert len(edges) < 2 or np.diff(edges).min() >= least


def test_a_shift_in_degrees_or_as_a_step_of_some() -> None:
    plain = {"kind": "phase", "axis": "u", "period_px": 8.0}
    quarter = Frame("phase", "u", period_px=8.0, shift=np.pi / 2)
    assert Frame.from_dict({**plain, "shift_deg": 90}) == quarter
    assert Frame.from_dict({**plain, "shift_step": [1, 4]}) == quarter
    for wrong, words in (
        ({"shift_deg": 90, "shift": 0.0}, "shift and shift_deg are given"),
        ({"shift_step": [1, 0]}, "N must be at least 1"),
        ({"shift_step": 3}, r"shift_step is 3, must be \[k, N\]"),
        ({"shift_deg": "x"}, "shift_deg is 'x', must be a number"),
    ):
        with pytest.raises(InputError, match=words):
            Frame.from_dict({**plain, **wrong}, "capture.toml: frames[3]")
