"""Fresnel reflectance and total reflection against textbook values and the figures of the design."""

import math

import numpy as np
import pytest

from optolever.scene import Medium


def at(medium, degrees):
    return float(medium.reflectance(np.cos(np.radians(degrees))))


def test_textbook_values():
    glass = Medium(1.0, outside=1.5)
    assert at(glass, 0) == pytest.approx(0.04, abs=1e-12)
    assert at(Medium(1.5), 0) == pytest.approx(0.04, abs=1e-12)
    brewster = math.degrees(math.atan(1.5))
    r_s = math.sin(math.radians(2 * brewster - 90)) ** 2  # at Brewster's angle only R_s is left: sin^2(i - t)
    assert at(glass, brewster) == pytest.approx(0.5 * r_s, abs=1e-12)
    assert at(glass, 90) == pytest.approx(1.0, abs=1e-12)
