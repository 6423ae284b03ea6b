"""docs/live.png: the live page while a surface vibrates by 100 nm beside a contact, by headless Chromium.

python docs/live_figure.py
"""

import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests" / "cli"))
from chromium import Chromium

from optolever.live import LiveServer, virtual_rig
from optolever.patterns import sequence
from optolever.projector import Image, footprints, light_of
from optolever.scene import Layer, Surface, dent, load, resize

RATE, HERTZ, SIZE = 30.0, 2.0, 1e-4  # frames a second; of the vibration, and its amplitude, mm
ELECTRONS = 30.0  # a level
SECONDS = 24  # before the picture
OUT = Path(__file__).with_name("live.png")


class Vibrating:
    """A contact at rest and a patch that vibrates; the light is quadratic in so small a depth."""

    def __init__(self, scene, period: float = 10.0) -> None:
        fringe = sequence("crossed", scene.pattern.rows, scene.pattern.cols, period=period)
        still = dent("gaussian", scene, peak=0.03, sigma=4.0, x=42.0, y=30.0)
        patch = dent("gaussian", scene, peak=SIZE, sigma=6.0, x=24.0, y=16.0)
        lights = []
        for depth in (-SIZE, 0.0, SIZE):
            surface = Surface(
                lambda x, y, k=depth / SIZE: still.height(x, y) + k * patch.height(x, y),
                lambda x, y, k=depth / SIZE: tuple(
                    a + k * b for a, b in zip(still.gradient(x, y), patch.gradient(x, y), strict=True)
                ),
            )
            seen = footprints(scene, surface, 0, scene.camera.rows)
            lights.append(light_of(seen, fringe, scene.display, scene.pattern.blur_px)[0])
        below, self._rest, above = (one.reshape(scene.camera.rows, -1) for one in lights)
        self._slope, self._bend = (above - below) / 2, (above + below) / 2 - self._rest
        self._rng, self._number, self._start = np.random.default_rng(1), 0, time.monotonic()

    def next(self, timeout_s: float) -> Image:
        due = self._start + self._number / RATE
        time.sleep(max(due - time.monotonic(), 0.0))
        phase = np.sin(2 * np.pi * HERTZ * self._number / RATE)
        light = self._rest + phase * self._slope + phase**2 * self._bend
        levels = self._rng.poisson(ELECTRONS * np.maximum(8 + 216 * light, 0)) / ELECTRONS
        self._number += 1
        return Image(np.clip(np.rint(levels), 0, 255).astype(np.uint8), self._number, None, time.monotonic())


def main() -> None:
    scene = replace(resize(load("prism48", exact=True), 240, 320), layer=Layer(0.3, 0.48, 8.0))
    prepared, _ = virtual_rig(scene, noise=2.0)
    with LiveServer(prepared, Vibrating(scene)) as server:
        while server.readings < 2:
            time.sleep(0.1)
        x, y = prepared.points[:2]
        for place in ((24.0, 16.0), (12.0, 36.0)):
            at = np.unravel_index(np.hypot(x - place[0], y - place[1]).argmin(), x.shape)
            server.command("probe", (at[0] / x.shape[0], at[1] / x.shape[1]))
        with tempfile.TemporaryDirectory() as folder, Chromium("chromium", Path(folder)) as page:
            page.open(server.address)
            page.look(1300, dark=False)
            time.sleep(SECONDS)
            page.picture(OUT)


if __name__ == "__main__":
    main()
