"""Photon noise through codes to heights: sigma is true at any gain, and nothing is noticed."""

from dataclasses import replace

import numpy as np
import pytest

from optolever.decode import decode
from optolever.patterns import sequence
from optolever.projector import capture
from optolever.reconstruct import reconstruct
from optolever.scene import Sensor, dent, load, resize, trace


@pytest.mark.parametrize("code", ["gray+phase", "phase"])
@pytest.mark.parametrize(("electrons", "read"), [(0.0, 1.0), (40.0, 0.7), (5.0, 0.7)])
def test_heights_of_a_prism(code: str, electrons: float, read: float) -> None:
    """rms(error / sigma) of a dent whose edge rests; no notice of the decoder. shared/cases/t4/shot_noise."""
    scene = resize(load("prism48", exact=True), 150, 200)
    surface = dent("gaussian", scene)
    shown = sequence(code, scene.pattern.rows, scene.pattern.cols)
    sensor = Sensor(noise=read, gain_e=electrons, exposure=0.85, offset=8.0)
    frames = capture(replace(scene, sensor=sensor), surface, shown, noise=read, seed=1).frames
    found = decode(frames, shown, lens_px=0.0)  # as drawn: the lens has its own error, in tests.world
    assert found.notices == ()
    truth, height = trace(scene, surface), reconstruct(found, scene)
    good = height.good & truth.visible
    assert good[truth.visible].mean() > 0.95
    assert 0.7 <= np.sqrt(np.mean(((height.z - truth.z) / height.sigma)[good] ** 2)) <= 1.4
