"""Swapped, lost, repeated and torn frames are named; whole captures are not."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from optolever import InputError
from optolever.decode import Correspondence, Flag, check, decode
from optolever.patterns import Sequence, sequence

F64 = NDArray[np.float64]
Shoot = Callable[..., NDArray[Any]]
CASES: tuple[tuple[str, dict[str, Any]], ...] = (
    ("phase", {"steps": 4}),
    ("phase", {"steps": 8, "periods": (190.0, 16.0)}),
    ("gray", {}),
    ("gray", {"references": False}),
    ("gray+phase", {"inverses": True}),
)


@pytest.mark.parametrize(("name", "params"), CASES)
def test_nothing_is_found_in_whole_captures(
    name: str, params: dict[str, Any], shoot: Shoot, smooth: tuple[F64, F64]
) -> None:
    shown = sequence(name, 150, 170, **params)
    for noise in (0.0, 1.0, 8.0):
        report = check(shoot(shown, *smooth, noise=noise), shown)
        assert report.findings == ()
        assert report.constraints > 0


@pytest.mark.parametrize(("name", "params"), CASES)
def test_neighbours_in_each_others_place_are_named(
    name: str, params: dict[str, Any], shoot: Shoot, smooth: tuple[F64, F64]
) -> None:
    shown = sequence(name, 150, 170, **params)
    frames = shoot(shown, *smooth, noise=1.0)
    first = len(shown) // 2 + len(shown) % 2 - 1
    frames[[first, first + 1]] = frames[[first + 1, first]]
    report = check(frames, shown)
    same_pair = shown.frames[first].bit is not None and shown.frames[first].bit == shown.frames[first + 1].bit
    if same_pair:
        assert report.findings == ()  # a bit and its inverse: nothing tells
    else:
        assert report.findings[0].kind == "swapped"
        assert {first, first + 1} <= set(report.findings[0].frames)


def test_a_lost_frame_is_named(shoot: Shoot, smooth: tuple[F64, F64]) -> None:
    shown = sequence("phase", 150, 170, steps=8, periods=(190.0, 16.0))
    frames = shoot(shown, *smooth, noise=1.0)
    frames[11:-1] = frames[12:].copy()
    found = check(frames, shown).findings
    assert found[0].kind == "lost"
    assert 11 in found[0].frames


def test_a_repeated_frame_is_named(shoot: Shoot, smooth: tuple[F64, F64]) -> None:
    shown = sequence("phase", 150, 170, steps=8, periods=(190.0, 16.0))
    frames = shoot(shown, *smooth, noise=1.0)
    frames[12:] = frames[11:-1].copy()
    found = check(frames, shown).findings
    assert found[0].kind == "repeated"
    assert {11, 12} & set(found[0].frames)


def test_a_torn_frame_is_named(shoot: Shoot, smooth: tuple[F64, F64]) -> None:
    shown = sequence("phase", 150, 170, steps=8, periods=(190.0, 16.0))
    frames = shoot(shown, *smooth, noise=1.0)
    frames[20, 70:] = frames[21, 70:]
    found = check(frames, shown).findings
    assert found[0].kind == "torn"
    assert 20 in found[0].frames


def test_three_steps_tell_nothing(shoot: Shoot, smooth: tuple[F64, F64]) -> None:
    shown = sequence("phase", 150, 170, steps=3)
    assert check(shoot(shown, *smooth), shown).constraints == 0


def test_frames_that_do_not_fit_are_refused() -> None:
    with pytest.raises(InputError, match="describes"):
        check(np.zeros((2, 4, 4), np.uint8), sequence("phase", 150, 170))


def _kinds(frames: NDArray[Any], shown: Sequence) -> tuple[set[str], Correspondence]:
    found = decode(frames, shown)
    return {finding.kind for finding in check(frames, shown, found).findings}, found


def test_bits_without_inverse_are_tested_by_the_map(shoot: Shoot, smooth: tuple[F64, F64]) -> None:
    """A Gray bit's picture that is the bit before: no sum tells, but the map jumps by the bit's worth."""
    shown = sequence("gray+phase", 150, 170)
    whole = shoot(shown, *smooth, noise=1.0)
    assert _kinds(whole, shown)[0] == set()
    bits = [i for i, frame in enumerate(shown.frames) if frame.kind == "gray" and (frame.bit or 0) >= 2]
    for i in bits[1:]:
        frames = whole.copy()
        frames[i] = whole[i - 1]
        kinds, found = _kinds(frames, shown)
        wrong = np.abs(found.u - smooth[0]) + np.abs(found.v - smooth[1]) > 1
        if wrong.mean() > 0.02:
            assert kinds == {"foreign"}, i
            assert (found.flags & Flag.WRONG_FRAME).all()
        assert wrong[found.good].mean() <= 1e-4 if found.good.any() else True


@pytest.mark.parametrize("name", ["gray", "long-run-gray", "xor-gray"])
def test_a_bit_in_its_inverses_place_is_told_by_the_map(
    shoot: Shoot, smooth: tuple[F64, F64], name: str
) -> None:
    """Both still add up to white; the coarsest bit alone only turns the map around."""
    shown = sequence(name, 150, 170)
    whole = shoot(shown, *smooth, noise=1.0)
    assert _kinds(whole, shown)[0] == set()
    for i, frame in enumerate(shown.frames):
        if frame.inverted and (frame.bit or 0) < 7:
            frames = whole.copy()
            frames[[i - 1, i]] = whole[[i, i - 1]]
            kinds, found = _kinds(frames, shown)
            wrong = np.abs(found.u - smooth[0]) + np.abs(found.v - smooth[1]) > 3
            assert kinds == {"foreign"} or not wrong[found.good].any(), i


@pytest.mark.parametrize(("bit", "source"), [(7, 0), (6, 0), (4, 1)])
def test_two_bits_that_show_the_same_picture_are_told(shoot: Shoot, bit: int, source: int) -> None:
    """A coarse bit with the finest one's picture is wrong in every other pixel: no jump stands alone."""
    row, col = np.mgrid[:160, :320].astype(np.float64)
    shown = sequence("gray", 256, 1024, inverses=False)
    frames = shoot(shown, 340 + 1.09 * col + 4 * np.sin(row / 30), 20 + 1.1 * row, noise=0.5)
    of_u = {frame.bit: i for i, frame in enumerate(shown.frames) if frame.axis == "u"}
    frames[of_u[bit]] = frames[of_u[source]]
    kinds, found = _kinds(frames, shown)
    assert kinds == {"foreign"}
    assert not found.good.any()


@pytest.mark.parametrize(
    ("jump", "at", "tilt"), [(37, 120, 0.0), (271, 309, 0.0), (63, 143, 0.1), (260, 328, 0.1)]
)
def test_the_straight_edge_of_an_object_is_no_wrong_frame(
    shoot: Shoot, jump: float, at: float, tilt: float
) -> None:
    """One of a few coarse bits explains many a jump; but not one of no whole number of periods."""
    row, col = np.mgrid[:200, :480].astype(np.float64)
    u = 350 + 0.6 * col + jump * (col + tilt * row > at)
    shown = sequence("gray+phase", 256, 1024, steps=4, period=14.0)
    kinds, found = _kinds(shoot(shown, u, 20 + 1.1 * row, noise=0.5), shown)
    assert kinds == set()
    assert found.good.mean() > 0.98


def test_a_jump_over_the_edges_of_several_bits_is_no_wrong_frame(shoot: Shoot) -> None:
    """Two bits that change within it only show the same picture."""
    row, col = np.mgrid[:120, :160].astype(np.float64)
    u = 80 + 0.3 * col + 830 * (np.hypot(row - 60, col - 80) < 40)
    shown = sequence("gray+phase", 256, 1024, steps=4, period=14.0)
    kinds, found = _kinds(shoot(shown, u, 20 + 1.1 * row, noise=0.5), shown)
    assert kinds == set()
    assert found.good.mean() > 0.9


def test_bits_that_came_too_early_are_told_by_their_likeness(shoot: Shoot, smooth: tuple[F64, F64]) -> None:
    """A lost frame, the last one there twice: a map that is twice as steep, without a jump."""
    shown = sequence("gray", 150, 170, inverses=False)
    whole = shoot(shown, *smooth, noise=1.0)
    for i in range(2, len(shown) - 1):
        found = decode(np.concatenate([whole[:i], whole[i + 1 :], whole[-1:]]), shown)
        wrong = np.abs(found.u - smooth[0]) + np.abs(found.v - smooth[1]) > 3
        assert wrong[found.good].mean() < 1e-4 if found.good.any() else True, i


def test_a_torn_bit_is_flagged_where_it_is_wrong(shoot: Shoot, smooth: tuple[F64, F64]) -> None:
    shown = sequence("gray+phase", 150, 170)
    frames = shoot(shown, *smooth, noise=1.0)
    torn = next(i for i, frame in enumerate(shown.frames) if frame.axis == "u" and frame.bit == 2)
    frames[torn, 70:] = frames[torn - 1, 70:]
    found = decode(frames, shown)
    assert (found.flags[70:] & Flag.WRONG_FRAME).all()
    assert found.good[:60].mean() > 0.9


@pytest.mark.parametrize(("name", "params"), CASES)
def test_what_a_wrong_frame_spoils_is_flagged(
    name: str, params: dict[str, Any], shoot: Shoot, smooth: tuple[F64, F64]
) -> None:
    """Every frame in turn is the one before again, or missing; nothing wrong stays unflagged."""
    shown = sequence(name, 150, 170, **params)
    whole = shoot(shown, *smooth, noise=1.0)
    limit = 1.5 if name == "gray" else None
    for i in range(1, len(shown), 3):
        replaced, lost = whole.copy(), whole.copy()
        replaced[i] = whole[i - 1]
        lost[i:-1] = whole[i + 1 :]
        for frames in (replaced, lost):
            found = decode(frames, shown)
            off = np.zeros(found.flags.shape, bool)
            for coord, sigma, true in ((found.u, found.sigma_u, 0), (found.v, found.sigma_v, 1)):
                off |= np.abs(coord - smooth[true]) > (5 * sigma if limit is None else limit)
            assert (off & found.good).mean() <= 1e-4, i


@pytest.mark.parametrize("step", [4.0, 8.0])
def test_sweeps_are_tested_by_how_stripes_follow_each_other(
    step: float, shoot: Shoot, smooth: tuple[F64, F64]
) -> None:
    shown = sequence("stripe", 150, 170, step=step)
    whole = shoot(shown, *smooth, noise=1.0)
    assert _kinds(whole, shown)[0] == set()
    i = len(shown) // 4
    faults = {name: whole.copy() for name in ("replaced", "swapped", "lost", "repeated")}
    faults["replaced"][i] = whole[i - 1]
    faults["swapped"][[i, i + 1]] = whole[[i + 1, i]]
    faults["lost"][i:-1] = whole[i + 1 :]
    faults["repeated"][i + 1 :] = whole[i:-1]
    for kind, frames in faults.items():
        kinds, found = _kinds(frames, shown)
        assert kinds == {kind}
        off = np.abs(found.u - smooth[0]) > 5 * found.sigma_u
        off |= np.abs(found.v - smooth[1]) > 5 * found.sigma_v
        assert (off & found.good).mean() <= 1e-4
        if kind in ("lost", "repeated"):
            assert not found.good.any()
        else:
            assert found.good.mean() > 0.5


def test_three_steps_in_another_order_are_another_mirror() -> None:
    """What `optolever hard` calls undecidable is so: the same frames, bit for bit, from another place."""
    shown = sequence("phase", 60, 60, steps=3, counts=0.9, axes="u")
    rng = np.random.default_rng(1)
    phase = rng.uniform(0, 2 * np.pi, (20, 30))
    shift = np.array([frame.shift for frame in shown.frames])[:, None, None]

    def images(at: F64) -> F64:
        return np.rint(120 + 100 * np.cos(at - shift))

    swapped = images(phase)[[0, 2, 1]]
    np.testing.assert_array_equal(swapped, images(-phase))
