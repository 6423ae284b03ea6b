"""Photon noise through codes to heights: sigma is true at any gain, and nothing is noticed."""

from dataclasses import replace

import numpy as np
import pytest

from optolever.decode import decode
from optolever.patterns import sequence
from optolever.projector import capture
from optolever.reconstruct import reconstruct
from optolever.scene import Sensor, dent, load, resize, trace

PRESETS = ("prism48", "paper-simulation", "paper-prototype")
#: Electrons a level (0: white noise alone) and read noise, levels.
CAMERAS = ((0.0, 1.0), (100.0, 0.7), (30.0, 0.7), (10.0, 0.7))


def ratio(preset: str, code: str, electrons: float, read: float, seed: int) -> float:
    """rms(error / sigma) of the heights of a dent, whose edge rests; no notice of the decoder."""
    scene = resize(load(preset, exact=True), 150, 200)
    surface = dent("gaussian", scene)
    shown = sequence(code, scene.pattern.rows, scene.pattern.cols)
    sensor = Sensor(noise=read, gain_e=electrons, exposure=0.85, offset=8.0)
    frames = capture(replace(scene, sensor=sensor), surface, shown, noise=read, seed=seed).frames
    found = decode(frames, shown, lens_px=0.0)  # as drawn: the lens has its own error, in tests.world
    assert found.notices == ()
    truth, height = trace(scene, surface), reconstruct(found, scene)
    good = height.good & truth.visible
    assert good[truth.visible].mean() > 0.95
    return float(np.sqrt(np.mean(((height.z - truth.z) / height.sigma)[good] ** 2)))


@pytest.mark.parametrize("code", ["gray+phase", "phase"])
@pytest.mark.parametrize(("electrons", "read"), [(0.0, 1.0), (40.0, 0.7), (5.0, 0.7)])
def test_a_prism(code: str, electrons: float, read: float) -> None:
    """shared/cases/t4/shot_noise."""
    assert 0.7 <= ratio("prism48", code, electrons, read, 1) <= 1.4
