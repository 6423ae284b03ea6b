"""Recordings: what has a line is there, whatever happened; replay is the rig again."""

import json
import re
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


def test_events_come_back_as_they_were(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    images = [
        Image(rng.integers(0, 256, (6, 8), np.uint8), 1, 2.5, 3.5),
        Image(np.empty((0, 0), np.uint8), 2, None, 3.6, False, "missing packets"),
        Image(rng.integers(0, 65536, (6, 8), np.uint16), 3, 2.7, 3.7),
    ]
    accepted = Accepted(0.01, 6, 8, unlocked=("exposure: automatic",))
    with Recorder(tmp_path / "r", {"camera": "virtual"}) as recorder:
        recorder.configured(accepted)
        recorder.shown(Shown(4, 1.25, True))
        for image in images:
            recorder.image(image, image.arrived_s - 1)
    found = Recording(tmp_path / "r")
    assert (found.about["camera"], found.accepted, len(found)) == ("virtual", accepted, 3)
    first, *rest = list(found)
    assert first == Shown(4, 1.25, True)
    for logged, image in zip(found.images(), images, strict=True):
        np.testing.assert_array_equal(logged.image.pixels, image.pixels)
        assert logged.image.pixels.dtype == image.pixels.dtype
        assert logged.stamp_s == image.arrived_s - 1
        for name in ("id", "device_s", "arrived_s", "complete", "why"):
            assert getattr(logged.image, name) == getattr(image, name)
    assert len(rest) == 3
    with pytest.raises(InputError, match="no empty folder"):
        Recorder(tmp_path / "r", {})


def test_an_mcap_file_holds_what_a_recording_holds(tmp_path: Path, root: Path) -> None:
    """Read back by the format's own packages, which decode the ROS 2 messages by the schemas in the file."""
    reader = pytest.importorskip("mcap.reader")
    ros2 = pytest.importorskip("mcap_ros2.decoder")
    rng = np.random.default_rng(0)
    images = [
        Image(rng.integers(0, 256, (5, 7), np.uint8), 11, None, 13.5),
        Image(np.empty((0, 0), np.uint8), 12, None, 13.6, False, "missing packets"),
        Image(rng.integers(0, 65536, (6, 8), np.uint16), 13, None, 13.7),
    ]
    with Recorder(tmp_path / "r", {"camera": "virtual"}) as recorder:
        recorder.shown(Shown(4, 12.25, True))
        for image in images:
            recorder.image(image, image.arrived_s - 1)
    write_mcap = runpy.run_path(str(root / "examples" / "mcap.py"))["write_mcap"]
    assert write_mcap(Recording(tmp_path / "r"), tmp_path / "r.mcap") == 2
    with (tmp_path / "r.mcap").open("rb") as file:
        factory = ros2.DecoderFactory()
        found = list(reader.make_reader(file, decoder_factories=[factory]).iter_decoded_messages())
    events = [json.loads(one.decoded_message.data) for one in found if one.channel.topic == "/log"]
    assert events[0]["camera"] == "virtual"
    assert events[1] == {"event": "shown", "index": 4, "swapped_s": 12.25, "late": True}
    assert events[2] == {"event": "incomplete", "id": 12, "why": "missing packets"}
    seen = [one for one in found if one.channel.topic == "/camera"]
    for one, image in zip(seen, (images[0], images[2]), strict=True):
        ros = one.decoded_message
        kind = {"mono8": "u1", "mono16": "<u2"}[ros.encoding]
        np.testing.assert_array_equal(
            np.frombuffer(ros.data, kind).reshape(ros.height, ros.width), image.pixels
        )
        assert (ros.step, ros.is_bigendian) == (image.pixels[0].nbytes, 0)
        assert ros.header.stamp.sec + 1e-9 * ros.header.stamp.nanosec == pytest.approx(image.arrived_s - 1)
        assert one.message.log_time == round(1e9 * (image.arrived_s - 1))
        assert one.message.publish_time == round(1e9 * image.arrived_s)
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
    whole = log.read_text()
    log.write_text(whole[:-20])  # broken off in the last line: that image does not exist
    assert len(list(Recording(tmp_path / "r"))) == 2
    lines = [json.loads(line) for line in whole.splitlines()]
    lines[2]["crc32"] += 1
    log.write_text("".join(json.dumps(line) + "\n" for line in lines))
    with pytest.raises(InputError, match="page 1 is damaged"):
        list(Recording(tmp_path / "r"))
    lines[2]["page"] = 7
    log.write_text("".join(json.dumps(line) + "\n" for line in lines))
    with pytest.raises(InputError, match="page 7 is missing"):
        list(Recording(tmp_path / "r"))
    shutil.rmtree(tmp_path / "r")
    with pytest.raises(InputError, match="no recording"):
        Recording(tmp_path / "r")


def test_a_log_damaged_in_the_middle_is_refused(tmp_path: Path) -> None:
    """Any byte of a line that others follow may be damaged: the line is named, or its image is checked and
    its times are those of the line. Of the last line it is taken as broken off."""
    with Recorder(tmp_path / "r", {"camera": "test"}) as recorder:
        for k in range(9):
            recorder.image(Image(np.full((4, 4), k, np.uint8), k, k / 30, k / 30), k / 30)
    log = tmp_path / "r" / "log.jsonl"
    whole = log.read_bytes()
    start = sum(len(line) + 1 for line in whole.split(b"\n")[:4])
    for at in range(start, start + len(whole.split(b"\n")[4])):
        damaged = bytearray(whole)
        damaged[at] = ord("x")
        log.write_bytes(damaged)
        said = ""
        try:
            assert len(list(Recording(tmp_path / "r").images())) == 9
        except InputError as error:
            said = str(error)
        assert re.search(r"^$|line 5 is damaged, 5 lines follow|page", said), said
    log.write_bytes(whole[:-20])
    assert len(Recording(tmp_path / "r")) == 8
    log.write_bytes(whole[:start] + b"\xff\n" + whole[start:])
    with pytest.raises(InputError, match=r"log\.jsonl: line 5 is damaged, 6 lines follow"):
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
