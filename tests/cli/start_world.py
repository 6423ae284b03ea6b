"""`optolever start` before a world that is not there: a real window on Xvfb, and a camera that reads the
server's frame buffer through the optics of a rig. A program of its own:

    python start_world.py WORLD.json FBDIR -- arguments of optolever

WORLD.json: rig (the true one's TOML), dent, gamma of the display, turned (the camera upside down), blind (it
looks elsewhere); read before every image.
"""

import faulthandler
import json
import signal
import sys
import time
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "projector"))
from screen import FrameBuffer, Optics

from optolever import scene
from optolever.cli import run
from optolever.projector import Accepted, Identity, Image, Wanted

IDENTITY = Identity("world", "Webcam C1", "1", "world:1", "", ("GREY",))
PERIOD, FULL = 1 / 40, 1 / 60  # s of an image; exposure at which white is 0.7 of full scale


class WorldCamera:
    """40 images a second, photon noise of 30 electrons a level."""

    identity, lost = IDENTITY, 0

    def __init__(self, world: Path, folder: Path) -> None:
        self._file, self._folder = world, folder
        self._text, self._world = "", dict[str, Any]()
        self._rng, self._count, self._last = np.random.default_rng(0), 0, 0.0
        self._look()

    def _look(self) -> None:
        text = self._file.read_text()
        if text == self._text:
            return
        self._text, self._world = text, json.loads(text)
        self._rig = scene.load(self._world["rig"], exact=True)
        surface = scene.dent_from_text(self._world.get("dent", "flat"), self._rig)
        self._optics = Optics(self._rig, surface)
        self._screen = FrameBuffer(self._folder, self._rig.pattern.rows, self._rig.pattern.cols)

    def configure(self, wanted: Wanted) -> Accepted:
        self._exposure = wanted.exposure_s
        return Accepted(wanted.exposure_s, self._rig.camera.rows, self._rig.camera.cols)

    def start(self) -> None:
        self._last = time.monotonic()

    def trigger(self) -> float:
        return time.monotonic()

    def next(self, timeout_s: float) -> Image | None:
        self._last = max(self._last + PERIOD, time.monotonic())
        time.sleep(max(self._last - time.monotonic(), 0.0))
        self._look()
        begun, light = time.monotonic(), (self._screen.pixels / 255.0) ** self._world.get("gamma", 1.0)
        seen = self._optics(light)
        seen = np.zeros_like(seen) if self._world.get("blind") else seen
        level = 12 + 0.7 * 243 * self._exposure / FULL * (
            seen[::-1, ::-1] if self._world.get("turned") else seen
        )
        level += np.sqrt(np.maximum(level, 1) / 30 + 0.3) * self._rng.standard_normal(level.shape)
        self._count += 1
        pixels = np.clip(np.rint(level), 0, 255).astype(np.uint8)
        return Image(pixels, self._count, begun, time.monotonic())

    def stop(self) -> None:
        pass

    def close(self) -> None:
        pass


def main() -> int:
    faulthandler.register(signal.SIGUSR1, chain=True)  # the test asks for the stacks, and it ends
    world, folder = Path(sys.argv[1]), Path(sys.argv[2])

    def open_camera(address: str) -> WorldCamera:
        assert address == IDENTITY.address
        return WorldCamera(world, folder)

    def find() -> Any:
        return [IDENTITY], {}

    with (
        mock.patch("optolever.camera.cameras.find_cameras", find),
        mock.patch("optolever.camera.cameras.open_camera", open_camera),
        mock.patch("optolever.camera.rig_devices.open_camera", open_camera),
    ):
        return run(sys.argv[4:])


if __name__ == "__main__":
    sys.exit(main())
