"""docs/live.png: the live page while a virtual finger presses, by headless Chromium.

python docs/live_figure.py
"""

import subprocess
from dataclasses import replace
from pathlib import Path

from optolever.live import LiveServer, VirtualFinger, virtual_rig
from optolever.projector import Image
from optolever.scene import Layer, load

CYCLE, DEEPEST = 48, 16  # frames of a press, and which of them is the deepest
RATE = 20.0  # frames a second
SECONDS = 9  # of the page's own time until the picture
OUT = Path(__file__).with_name("live.png")


class Held:
    """The finger's frames of one press, then the last one over and over."""

    def __init__(self, finger: VirtualFinger) -> None:
        self._finger, self._last = finger, 0

    def next(self, timeout_s: float) -> Image | None:
        image = self._finger.next(timeout_s)
        if image is not None and self._last < CYCLE:
            self._last, self._image = self._last + 1, image
        return None if image is None else replace(image, pixels=self._image.pixels)


def main() -> None:
    scene = replace(load("prism48", exact=True), layer=Layer(0.3, 0.48, 8.0))
    prepared, finger = virtual_rig(scene, rate=RATE)
    for _ in range(CYCLE + DEEPEST):  # its pictures are rendered once
        while finger.next(60.0) is None:
            pass
    with LiveServer(prepared, Held(finger)) as server:
        words = ["--headless", "--no-sandbox", "--hide-scrollbars", "--window-size=1300,860"]
        words += [f"--virtual-time-budget={1000 * SECONDS}", f"--screenshot={OUT}", server.address]
        subprocess.run(["chromium", *words], check=True, capture_output=True, timeout=60)


if __name__ == "__main__":
    main()
