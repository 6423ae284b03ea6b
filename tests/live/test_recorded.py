"""Readings that were recorded beside their frames, again from the frames."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from optolever.camera.cameras import StillCamera
from optolever.cli import run
from optolever.live import Followed, Live, Prepared, ReadingRecorder, VirtualFinger, replayed, virtual_rig
from optolever.patterns import sequence
from optolever.projector import WHITE_NOISE_SENSOR, Image, capture
from optolever.scene import Layer, dent, load, resize


@pytest.fixture(scope="module")
def virtual() -> tuple[Prepared, VirtualFinger]:
    scene = replace(resize(load("prism48", exact=True), 96, 128), layer=Layer(0.2, 0.45, 8.0))
    return virtual_rig(scene)


def test_readings_are_bit_identical(virtual: tuple[Prepared, VirtualFinger], tmp_path: Path) -> None:
    """Contacts, forces and a black frame, after which the fit starts anew; then a killed recording."""
    prepared, finger = virtual
    live, readings = Live(prepared), []
    with ReadingRecorder(tmp_path / "film", prepared, "virtual") as recorder:
        for k in range(20):
            image = finger.next(1.0)
            assert image is not None
            if k == 12:
                image = replace(image, pixels=np.zeros_like(image.pixels))
            readings.append(live.update(image.pixels, image.arrived_s))
            recorder.write(Followed(readings[-1], image, 0.1))
    again = list(replayed(tmp_path / "film"))
    assert all(one.identical for one in again)
    assert [one.followed.reading for one in again] == readings
    assert sum(reading.trusted for reading in readings) == 19
    assert sum(bool(reading.forces) for reading in readings) > 10
    path = tmp_path / "film" / "log.jsonl"
    lines = path.read_text().splitlines(keepends=True)
    path.write_text("".join(lines[:8]) + lines[8][:30])
    assert len(list(replayed(tmp_path / "film"))) == 7


def test_the_program_records_and_compares(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """What is not the recorded reading is counted, and said."""
    film, numbers = tmp_path / "film", tmp_path / "n.json"
    words = ["live", "--pixels", "128x96", "--rate", "0", "--frames", "5"]
    assert run([*words, "--headless", "--record", str(film)]) == 0
    assert run([*words, "--headless", "--record", str(film)]) == 2
    assert "exists and is no empty folder" in capsys.readouterr().err
    assert run(["camera", "replay", str(film), "--json", str(numbers)]) == 0
    assert "5 of 5 bit-identical" in capsys.readouterr().out
    lines = [json.loads(line) for line in (film / "log.jsonl").read_text().splitlines()]
    lines[4]["reading"]["crc32"][0] += 1
    (film / "log.jsonl").write_text("\n".join(map(json.dumps, lines)))
    assert run(["camera", "replay", str(film), "--json", str(numbers)]) == 0
    streams = capsys.readouterr()
    assert "4 of 5 bit-identical" in streams.out
    assert "Notice: 1 of 5 readings differ from the recorded ones" in streams.err
    assert json.loads(numbers.read_text())["identical"] == 4


def test_a_rig_is_measured_at_rest_and_followed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The camera of a rig, pressed after its rest: the depth of the dent; options of the other camera."""
    scene = replace(resize(load("prism48"), 96, 128), dent="flat", sensor=WHITE_NOISE_SENSOR)
    scene.save(tmp_path / "rig.toml")  # white noise of 0: the virtual camera repeats an image's photons
    rows, cols = scene.pattern.rows, scene.pattern.cols
    dense = sequence("gray+phase", rows, cols)
    fringe = sequence("crossed", rows, cols, period=10.0)
    pressed = capture(scene, dent("gaussian", scene, peak=0.06, sigma=6), fringe, renderer="numpy")
    following, count = StillCamera.next, iter(range(1000))

    def press(camera: StillCamera, timeout_s: float) -> Image | None:
        image = following(camera, timeout_s)
        rest = next(count) < len(dense) + 11  # two readings at rest, or one
        return image if rest or image is None else replace(image, pixels=pressed[0])

    monkeypatch.setattr(StillCamera, "next", press)
    words = ["live", "--rig", str(tmp_path / "rig.toml"), "--headless", "--frames", "4"]
    assert run([*words, "--set", "camera=virtual", "--json", str(tmp_path / "n.json")]) == 0
    numbers = json.loads((tmp_path / "n.json").read_text())
    assert numbers["trusted"] == 4
    assert numbers["depth_mm"] == pytest.approx(0.06, rel=0.02)
    capsys.readouterr()
    for wrong, said in (
        ([*words, "--noise", "1"], "--noise: is of the simulated camera"),
        ([*words], "camera is missing; give --set camera="),
        (["live", "--set", "fps=20"], "--set: needs --rig"),
    ):
        assert run(wrong) == 2
        assert said in capsys.readouterr().err
