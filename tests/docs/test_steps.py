"""README's four steps, as they stand, on a display of gamma 2.2, with a camera that takes the pictures."""

import re
import shlex
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from optolever import projector
from optolever.cli import run
from optolever.patterns import sequence
from optolever.projector import Monitor
from optolever.reconstruct import HeightMap
from optolever.scene import Display, dent, load, resize

ROOT = Path(__file__).resolve().parents[2]


class Window:
    """A monitor that nobody looks at."""

    gone = False

    def __init__(self, *_: object, **__: object) -> None: ...

    def __enter__(self) -> "Window":
        return self

    def __exit__(self, *_: object) -> None: ...

    def run(self) -> None: ...


def lines() -> list[list[str]]:
    """The commands of README's section, by hand."""
    section = (
        (ROOT / "README.md").read_text().partition("## A capture of your own\n")[2].partition("\n## ")[0]
    )
    blocks = re.findall(r"(?<!-->\n)```console\n(.*?)```", section, re.DOTALL)
    (steps,) = (block for block in blocks if "show" in block)
    return [shlex.split(line.removeprefix("$ optolever ")) for line in steps.splitlines()]


def test_the_four_steps_run_as_they_stand(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    rig = resize(load("monitor-mirror"), 72, 90)
    rig.save("rig.toml")
    shape = rig.pattern.rows, rig.pattern.cols
    screens = [Monitor(0, "one", 480, 640, 60), Monitor(1, "two", *shape, 60)]
    monkeypatch.setattr(projector, "monitors", lambda: screens)
    monkeypatch.setattr(projector, "PatternWindow", Window)
    pressed: Any = dent("gaussian", rig, peak=0.1, sigma=20.0)
    bent = replace(rig, display=Display(gamma=2.2))

    def photograph(name: str, surface: Any) -> None:
        code = "ramp" if name == "ramp" else "gray+phase"
        taken = projector.capture(bent, surface, sequence(code, *shape), noise=1.0, renderer="numpy")
        for i, image in enumerate(taken.frames):
            cv2.imwrite(str(tmp_path / name / f"IMG_{i + 1}.png"), image)

    (tmp_path / "pressed").mkdir()
    photograph("pressed", pressed)
    for line in lines():
        assert run(line) == 0, line
        if line[0] == "show":  # which makes the folder
            photograph(Path(line[-1]).parent.name, dent("flat", rig))
    height = HeightMap.load("h.npz")
    error = (height.z - pressed.height(height.x, height.y))[height.good]
    assert height.good.mean() > 0.95
    assert np.std(error) < 1.5 * np.median(height.sigma[height.good]) < 1e-3  # mm, of a dent of 0.1
