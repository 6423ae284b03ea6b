"""Recordings: what has a line is there, whatever happened; replay is the rig again."""

import json
import runpy
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from lab.hardware.simulated import Setting, SimulatedCamera, SimulatedDisplay, SimulatedTime, codes
from optolever import InputError
from optolever.projector import (
    Accepted,
    ClockMap,
    Image,
    Recorder,
    Recording,
    Shown,
    Taken,
    Wanted,
    acquire,
)
from optolever.projector.cameras import Replay, open_camera

WRITER = """
import sys, numpy as np
from optolever.projector import Image, Recorder
recorder = Recorder(sys.argv[1], {})
print("go", flush=True)
for k in range(100000):
    recorder.image(Image(np.full((48, 64), k % 251, np.uint8), k, None, float(k)), float(k))
"""


def recorded(folder: Path) -> list[Image]:
    """A recording of a swap and three images, the second of them incomplete; those images."""
    rng = np.random.default_rng(0)
    images = [
        Image(rng.integers(0, 256, (5, 7), np.uint8), 11, 2.5, 13.5),
        Image(np.empty((0, 0), np.uint8), 12, None, 13.6, False, "missing packets"),
        Image(rng.integers(0, 65536, (6, 8), np.uint16), 13, None, 13.7),
    ]
    with Recorder(folder, {"camera": "virtual"}) as recorder:
        recorder.configured(Accepted(0.01, 6, 8, unlocked=("exposure: automatic",)))
        recorder.shown(Shown(4, 12.25, True))
        for image in images:
            recorder.image(image, image.arrived_s - 1)
    return images


def test_events_come_back_as_they_were(tmp_path: Path) -> None:
    images, found = recorded(tmp_path / "r"), Recording(tmp_path / "r")
    assert (found.about["camera"], len(found)) == ("virtual", 3)
    assert found.accepted == Accepted(0.01, 6, 8, unlocked=("exposure: automatic",))
    first, *rest = list(found)
    assert (first, len(rest)) == (Shown(4, 12.25, True), 3)
    for logged, image in zip(found.images(), images, strict=True):
        np.testing.assert_array_equal(logged.image.pixels, image.pixels)
        assert logged.image.pixels.dtype == image.pixels.dtype
        assert logged.stamp_s == image.arrived_s - 1
        for name in ("id", "device_s", "arrived_s", "complete", "why"):
            assert getattr(logged.image, name) == getattr(image, name)
    with pytest.raises(InputError, match="no empty folder"):
        Recorder(tmp_path / "r", {})


def test_an_mcap_file_holds_what_a_recording_holds(tmp_path: Path, root: Path) -> None:
    """Read back by the format's own packages, which decode the ROS 2 messages by the schemas in the file."""
    reader = pytest.importorskip("mcap.reader")
    ros2 = pytest.importorskip("mcap_ros2.decoder")
    images = recorded(tmp_path / "r")
    write_mcap = runpy.run_path(str(root / "examples" / "mcap.py"))["write_mcap"]
    assert write_mcap(Recording(tmp_path / "r"), tmp_path / "r.mcap") == 2
    with (tmp_path / "r.mcap").open("rb") as file:
        messages = reader.make_reader(file, decoder_factories=[ros2.DecoderFactory()])
        found = list(messages.iter_decoded_messages())
    events = [json.loads(one.decoded_message.data) for one in found if one.channel.topic == "/log"]
    assert events[0]["camera"] == "virtual"
    assert {"event": "shown", "index": 4, "swapped_s": 12.25, "late": True} in events
    assert events[-1] == {"event": "incomplete", "id": 12, "why": "missing packets"}
    seen = [one for one in found if one.channel.topic == "/camera"]
    for one, image in zip(seen, (images[0], images[2]), strict=True):
        ros = one.decoded_message
        kind = {"mono8": "u1", "mono16": "<u2"}[ros.encoding]
        pixels = np.frombuffer(ros.data, kind).reshape(ros.height, ros.width)
        np.testing.assert_array_equal(pixels, image.pixels)
        assert (ros.step, ros.is_bigendian) == (image.pixels[0].nbytes, 0)
        assert ros.header.stamp.sec + 1e-9 * ros.header.stamp.nanosec == pytest.approx(image.arrived_s - 1)
        assert one.message.log_time == round(1e9 * (image.arrived_s - 1))
        assert one.message.sequence == image.id


@pytest.mark.daily(1)
@pytest.mark.parametrize("after", [0.05, 0.2, 0.6])
def test_killed_at_any_moment(tmp_path: Path, after: float) -> None:
    """kill -9: all images that have a line are right, and they are nearly all that were written."""
    words = [sys.executable, "-c", WRITER, str(tmp_path / "r")]
    with subprocess.Popen(words, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stdout.readline().strip() == "go"
        time.sleep(after)
        process.send_signal(signal.SIGKILL)
    seen = list(Recording(tmp_path / "r").images())
    assert len(seen) > 3
    assert [one.image.id for one in seen] == list(range(len(seen)))
    for k, one in enumerate(seen):
        assert (one.image.pixels == k % 251).all()


def test_damage_is_told(tmp_path: Path) -> None:
    with Recorder(tmp_path / "r", {}) as recorder:
        for k in range(3):
            recorder.image(Image(np.full((6, 8), k, np.uint8), k, None, 0.0), 0.0)
    log = tmp_path / "r" / "log.jsonl"
    whole = log.read_bytes()
    log.write_bytes(whole[:-20])  # broken off in the last line: that image does not exist
    assert len(list(Recording(tmp_path / "r"))) == 2
    about, first, *rest = whole.splitlines(keepends=True)
    other, away = ({**json.loads(first), **change} for change in ({"crc32": 1}, {"page": 7}))
    for line, words in (
        (json.dumps(other).encode() + b"\n", "page 0 is damaged"),
        (json.dumps(away).encode() + b"\n", "page 7 is missing"),
        (b"\xff\n" + first, r"log\.jsonl: line 2 is damaged, 3 lines follow"),
    ):
        log.write_bytes(b"".join([about, line, *rest]))
        with pytest.raises(InputError, match=words):
            list(Recording(tmp_path / "r"))
    shutil.rmtree(tmp_path / "r")
    with pytest.raises(InputError, match="no recording"):
        Recording(tmp_path / "r")


def test_a_replay_takes_the_same_images(tmp_path: Path) -> None:
    setting, rng = Setting(lost=0.1, incomplete=0.1), np.random.default_rng(5)
    time, order = SimulatedTime(), [3, 1, 4, 1, 5]
    display = SimulatedDisplay(setting, time, codes(8, rng), rng)
    camera = SimulatedCamera(setting, time, display, rng)
    with Recorder(tmp_path / "r", {"refresh_s": setting.refresh}) as recorder:
        recorder.configured(camera.configure(Wanted(0.01)))
        camera.start()
        events = {"on_image": recorder.image, "on_shown": recorder.shown}
        first = list(acquire(display, camera, None, order, time=time, clock=ClockMap(), **events))

    def again() -> list[Taken]:
        replay = open_camera(f"replay:{tmp_path / 'r'}")
        assert isinstance(replay, Replay)
        assert replay.refresh_s == setting.refresh
        return list(acquire(replay, replay, None, order, time=replay, clock=ClockMap()))

    for found in (again(), again()):
        assert [(one.index, one.image.id, one.stamp_s) for one in found] == [
            (one.index, one.image.id, one.stamp_s) for one in first
        ]
        assert all((a.image.pixels == b.image.pixels).all() for a, b in zip(found, first, strict=True))
