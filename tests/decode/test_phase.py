"""The phase of two sums, in float32, and the probability of a wrong order, against NumPy's in float64."""

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from optolever.decode.jit import apart_kernel, outer_kernel
from optolever.decode.phase_kernels import phase_of
from optolever.decode.unwrap_kernels import doubt_of

F32 = NDArray[np.float32]


@apart_kernel
def _phases(c: F32, s: F32, turns: F32, power: F32, inverse: F32) -> None:
    for x in range(len(c)):
        turns[x], power[x], inverse[x] = phase_of(c[x], s[x])


@outer_kernel
def phases(c: F32, s: F32, turns: F32, power: F32, inverse: F32) -> None:
    _phases(c, s, turns, power, inverse)


def found(c: Any, s: Any) -> F32:
    told = np.empty((3, len(c)), np.float32)
    phases(c.astype(np.float32), s.astype(np.float32), *told)
    return told


@pytest.mark.parametrize("size", [0.5, 1.0, 37.25, 255.0, 65535.0])
def test_all_directions(size: float) -> None:
    """The axes and the bisectors among them. Error: the polynomial's 6e-9 turns, and a rounding at 1/2."""
    at = np.linspace(-np.pi, np.pi, 8 * 12345 + 1)
    c, s = (np.float32(size) * part(at).astype(np.float32) for part in (np.cos, np.sin))
    turns, power, inverse = found(c, s)
    exact = np.arctan2(s.astype(float), c.astype(float)) / (2 * np.pi)
    off = np.abs((turns - exact + 0.5) % 1 - 0.5)
    assert off.max() < 6e-9 + 2**-24
    assert np.abs(turns).max() <= 0.5
    square = c.astype(float) ** 2 + s.astype(float) ** 2
    np.testing.assert_allclose(power, square, rtol=3e-7)
    np.testing.assert_allclose(inverse, 1 / square, rtol=6e-7)


def test_whole_numbers() -> None:
    """Differences of grey values; nothing is known where both are 0, and the answer is a number."""
    c, s = (each.ravel() for each in np.meshgrid(np.arange(-255.0, 256), np.arange(-255.0, 256)))
    turns, power, inverse = found(c, s)
    seen = (c != 0) | (s != 0)
    off = turns - np.arctan2(s, c) / (2 * np.pi)
    assert np.abs((off[seen] + 0.5) % 1 - 0.5).max() < 6e-9 + 2**-24
    assert np.array_equal(power, c * c + s * s)
    assert np.isfinite(turns).all()
    assert np.isfinite(inverse).all()
    assert (inverse[seen] > 0).all()


def test_the_answer_does_not_depend_on_where_a_pixel_lies() -> None:
    """In a vector of the processor's, in what is left beyond these, or alone: the same to the last bit."""
    c, s = np.random.default_rng(2).uniform(-200, 200, (2, 150)).astype(np.float32)
    whole = found(c, s)
    for first in range(0, 70, 3):
        assert np.array_equal(found(c[first:], s[first:]), whole[:, first:])
    alone = np.concatenate([found(c[x : x + 1], s[x : x + 1]) for x in range(len(c))], axis=1)
    assert np.array_equal(alone, whole)


@apart_kernel
def _doubts(near: F32, far: F32, doubt: F32) -> None:
    for x in range(len(near)):
        doubt[x] = doubt_of(near[x], far[x])


@outer_kernel
def doubts(near: F32, far: F32, doubt: F32) -> None:
    _doubts(near, far, doubt)


def test_the_probability_of_an_order_beside() -> None:
    """Of two that are worse by `near` and `far` in chi squared; if as good, 1/2 or 2/3."""
    near = np.concatenate([[0.0, 0.0], np.geomspace(1e-6, 40, 4000)]).astype(np.float32)
    far = (near * np.float32(1.5)).astype(np.float32)
    far[1] = 1e6
    doubt = np.empty_like(near)
    doubts(near, far, doubt)
    other = np.exp(-0.5 * near.astype(float)) + np.exp(-0.5 * far.astype(float))
    np.testing.assert_allclose(doubt, other / (1 + other), rtol=2e-5)
    np.testing.assert_allclose(doubt[:2], [2 / 3, 1 / 2], rtol=1e-6)
