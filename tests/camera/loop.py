"""The whole chain without hardware, as a program of its own in a network of its own; prints JSON.

    python loop.py FBDIR ROWSxCOLS FRAMES FAULTS(JSON)

Window (its process) on Xvfb -> frame buffer -> crystal -> optics -> rolling shutter -> GigE Vision ->
back-end -> synchronisation -> capture -> decode -> height, beside the virtual
sensor's own captures with as much noise.
"""

import json
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from optolever import decode, patterns, projector, reconstruct, scene
from optolever.camera import ClockMap, acquire, synchronise
from optolever.camera.cameras import open_camera
from optolever.projector import PatternWindow, RealTime, Shown, Wanted

DENT = "gaussian:peak=0.3,sigma=8"
REFRESH = 1 / 60
EXPOSURE = 1 / 60


class VsyncDisplay:
    """A PatternWindow whose swaps happen at 60 Hz, as the panel is told: Xvfb knows no vertical blank."""

    refresh_s = REFRESH

    def __init__(self, window: PatternWindow, note: Path) -> None:
        self._window, self._note = window, np.memmap(note, np.float64, "r+", shape=(3,))

    def show(self, index: int) -> Shown:
        swapped = self._window.show(index).swapped_s
        blank = (np.floor(swapped / REFRESH) + 1) * REFRESH
        self._note[1] = blank
        self._note[0] += 1
        while self._note[2] != self._note[0]:
            time.sleep(2e-4)
        time.sleep(max(0.0, blank - time.monotonic()))
        return Shown(index, float(blank))


def main() -> None:
    folder, size, count, faults = Path(sys.argv[1]), sys.argv[2], int(sys.argv[3]), json.loads(sys.argv[4])
    note = folder / "note"
    np.zeros(3).tofile(note)
    words = [sys.executable, Path(__file__).with_name("panel_camera.py"), folder, note, size, DENT]
    with subprocess.Popen(
        list(map(str, words)), stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as host:
        try:
            print(json.dumps(run(host, size, note, count, faults)))
        finally:
            host.kill()


def told(host: "subprocess.Popen[str]", **values: float) -> None:
    assert host.stdin is not None
    assert host.stdout is not None
    host.stdin.write(json.dumps(values) + "\n")
    host.stdin.flush()
    assert host.stdout.readline().strip() == "ok"


def errors(
    rig: scene.Scene, dent: scene.Surface, shown: patterns.Sequence, captures: list[np.ndarray]
) -> dict[str, float]:
    """Rms of u (cells) and of the height (mm) over captures: that of one scatters by a tenth."""
    truth, places, heights = scene.trace(rig, dent), [], []
    for frames in captures:
        seen = decode.decode(frames, shown)
        height = reconstruct.reconstruct(seen, rig)
        places.append(np.mean((seen.u - truth.u)[(seen.flags == 0) & truth.visible] ** 2))
        heights.append(np.mean((height.z - truth.z)[height.good & truth.visible] ** 2))
    return {"u_rms": float(np.sqrt(np.mean(places))), "height_rms": float(np.sqrt(np.mean(heights)))}


def run(
    host: "subprocess.Popen[str]", size: str, note: Path, count: int, faults: dict[str, float]
) -> dict[str, object]:
    rows, cols = map(int, size.split("x"))
    rig = replace(scene.resize(scene.load("prism48"), rows, cols), sensor=projector.WHITE_NOISE_SENSOR)
    dent = scene.dent_from_text(DENT, rig)
    shown = patterns.sequence("gray+phase", rig.pattern.rows, rig.pattern.cols)
    flat = (patterns.Frame("black"), patterns.Frame("white"))
    both = patterns.Sequence((*flat, *shown.frames), shown.rows, shown.cols)
    clean = projector.capture(rig, dent, shown, renderer="numpy").frames.astype(np.float64)
    assert host.stdout is not None
    assert host.stdout.readline().strip() == "ready"
    camera, clock, real = open_camera("serial:BENCH-1"), ClockMap(), RealTime()
    accepted = camera.configure(Wanted(EXPOSURE, rows, cols, fps=50))
    with PatternWindow(both, monitor=0) as window:
        display = VsyncDisplay(window, note)
        camera.start()
        timing, _ = synchronise(display, camera, accepted, time=real, clock=clock)
        if faults:
            told(host, **faults)
        order = [k % len(shown) for k in range(count)]
        wrong, worst = 0, 0.0
        taken: dict[int, list[np.ndarray]] = {}
        images = acquire(display, camera, timing, [k + 2 for k in order], time=real, clock=clock)
        for count_of, one in enumerate(images):
            index = one.index - 2
            off = float(np.sqrt(np.mean((one.image.pixels - clean[index]) ** 2)))
            wrong, worst = wrong + (off > 2), max(worst, off)
            taken.setdefault(count_of // len(shown), []).append(one.image.pixels)
        camera.close()
    rounds = [np.stack(one) for one in taken.values() if len(one) == len(shown)]
    own = [
        projector.capture(rig, dent, shown, noise=1.0, seed=k, renderer="numpy").frames
        for k in range(len(rounds))
    ]
    found = {"loop": errors(rig, dent, shown, rounds), "own": errors(rig, dent, shown, own)}
    return {"frames": count, "wrong": wrong, "worst": worst, "timing": timing.to_table(), **found}


if __name__ == "__main__":
    main()
