"""Many captures: wall-clock time of two processes beside one."""

import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

from optolever.patterns import sequence
from optolever.projector import capture
from optolever.scene import dent, load, resize

from .figures import Figure

COUNT, SIZE = 50, (240, 320)
_RUN = "from optolever.cli import main; main()"


def batch_figures() -> Iterator[Figure]:
    """COUNT captures decoded by one process and by two, and again where nothing is left to do."""
    scene = resize(load("prism48", exact=True), *SIZE)
    shown = sequence("gray+phase", scene.pattern.rows, scene.pattern.cols)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        one = folder / "c00"
        capture(scene, dent("gaussian", scene, peak=0.3, sigma=8.0), shown, noise=1.0).save(one)
        many = [one, *(folder / f"c{k:02}" for k in range(1, COUNT))]
        for copy in many[1:]:
            shutil.copytree(one, copy)
        _seconds(many[:2], folder / "warm", 1)  # kernels compiled
        alone, two = (_seconds(many, folder / f"o{jobs}", jobs) for jobs in (1, 2))
        again = _seconds(many, folder / "o1", 1)
    what = f"{COUNT} captures of {SIZE[1]} x {SIZE[0]}"
    note = f"{alone:.1f} s, {two:.1f} s; {os.cpu_count()} cores"
    yield Figure(f"{what}, `--jobs 1` over `--jobs 2`", alone / two, low=1.7, note=note)
    yield Figure(f"{what}, a second run", again, "s", note="nothing to do")


def _seconds(captures: list[Path], out: Path, jobs: int) -> float:
    start = time.perf_counter()
    words = ["decode", *map(str, captures), "--out", str(out), "--jobs", str(jobs)]
    subprocess.run([sys.executable, "-c", _RUN, *words], check=True, capture_output=True)
    return time.perf_counter() - start
