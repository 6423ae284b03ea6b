"""The other side of the glass: Xvfb's frame buffer -> crystal -> a scene's optics -> shutter -> GigE Vision.

    python panel_camera.py FBDIR NOTE ROWSxCOLS DENT

NOTE: three float64 in a shared file: number and time of the display's last swap, number that the panel has
taken. Commands on stdin, a JSON object a line, set the panel and the sensor.
"""

import json
import sys
import threading
import time
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

sys.path.insert(0, str(Path(__file__).parent))
sys.path.insert(0, str(Path(__file__).parents[1] / "projector"))
from gige_host import GigEHost, Request
from screen import FrameBuffer, Optics

from optolever import scene


class Panel(threading.Thread):
    """Takes the frame buffer at every swap that the display notes; right at any load of the computer."""

    def __init__(self, buffer: FrameBuffer, optics: Optics, note: Path) -> None:
        super().__init__(daemon=True)
        self._buffer, self._optics = buffer, optics
        self._note = np.memmap(note, np.float64, "r+", shape=(3,))
        self.history: list[tuple[float, NDArray[np.float64]]] = []
        self.lock = threading.Lock()

    def run(self) -> None:
        while True:
            number, swapped = self._note[0], self._note[1]
            if number == self._note[2]:
                time.sleep(5e-4)
                continue
            light = self._optics(self._buffer.pixels / 255.0)
            with self.lock:
                self.history = [*self.history[-11:], (float(swapped), light)]
            self._note[2] = number

    def settle(self, until: float) -> None:
        """Wait for swaps before a time that were noted and not yet taken."""
        while self._note[0] != self._note[2] and self._note[1] < until:
            time.sleep(5e-4)


class Sensor:
    """Seconds. Rows are exposed one after the other; each integrates what the crystal shows exactly."""

    def __init__(self, panel: Panel) -> None:
        self._panel, self._rng = panel, np.random.default_rng(0)
        self.delay, self.rise, self.shutter, self.noise = 8e-3, 4e-3, 10e-3, 1.0
        self.drift, self.offset, self.queue, self.gap_every = 30e-6, 1234.5, 0, 0
        self._images, self._skipped = 0, 0
        self._waiting: list[tuple[NDArray[np.float64], int, int]] = []

    def __call__(self, request: Request) -> NDArray[np.float64]:
        end = time.monotonic()  # an image comes when its last row has been read
        begin = end - self.shutter - request.exposure_s
        self._images += 1
        if self.gap_every and self._images % self.gap_every == 0:
            self._skipped += 1
        number = (request.frame_id - 1 + self._skipped) % 65535 + 1
        device = int(1e9 * (begin * (1 + self.drift) + self.offset))
        self._panel.settle(end)
        with self._panel.lock:
            history = list(self._panel.history)
        rows = begin + self.shutter * np.arange(request.rows) / request.rows
        light = np.zeros((request.rows, request.cols))
        share = [self._followed(rows, request.exposure_s, swapped) for swapped, _ in history]
        for k, (_, picture) in enumerate(history):
            mine = (1.0 if k == 0 else share[k]) - (share[k + 1] if k + 1 < len(history) else 0.0)
            light += np.broadcast_to(mine, rows.shape)[:, None] * picture
        level = 16 + 216.75 * light + self._rng.normal(0, self.noise, light.shape)
        self._waiting.append((np.clip(np.rint(level), 0, 255), number, device))
        image, request.frame_id, request.device_ns = self._waiting[0]
        if len(self._waiting) > self.queue:
            self._waiting.pop(0)
        return image

    def _followed(self, rows: NDArray[np.float64], exposure: float, swapped: float) -> NDArray[np.float64]:
        """Mean over each row's exposure of 1 - exp(-t / rise) since the light of a swap began to change."""
        begin = np.maximum(rows - swapped - self.delay, 0)
        end = np.maximum(rows + exposure - swapped - self.delay, 0)
        lag = self.rise * (np.exp(-begin / self.rise) - np.exp(-end / self.rise))
        return (end - begin - lag) / exposure


def main() -> None:
    rows, cols = map(int, sys.argv[3].split("x"))
    rig = scene.resize(scene.load("prism48"), rows, cols)
    buffer = FrameBuffer(Path(sys.argv[1]), rig.pattern.rows, rig.pattern.cols)
    panel = Panel(buffer, Optics(rig, scene.dent_from_text(sys.argv[4], rig)), Path(sys.argv[2]))
    panel.start()
    sensor = Sensor(panel)
    with GigEHost(sensor, serial="BENCH-1") as host:
        print("ready", flush=True)
        for line in sys.stdin:
            for name, value in json.loads(line).items():
                host.lose(value) if name == "lose" else setattr(sensor, name, value)
            print("ok", flush=True)


if __name__ == "__main__":
    main()
