"""Recordings: what has a line is there, whatever happened; replay is the rig again."""

import json
import shutil
import signal
import subprocess
import sys
import threading
import time
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lab.hardware.simulated import Setting, SimulatedCamera, SimulatedDisplay, SimulatedTime, codes
from optolever import InputError
from optolever.camera import BackgroundRecorder, ClockMap, Recorder, Recording, Taken, acquire
from optolever.camera.cameras import Replay, open_camera
from optolever.live import Live, ReadingRecorder, follow, virtual_rig
from optolever.projector import Accepted, Image, Shown, Wanted
from optolever.scene import Layer, load, resize

WRITER = """
import sys, numpy as np
from optolever.camera import Recorder
from optolever.projector import Image
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


def _in_mcap(root: Path, folder: Path) -> list[Any]:
    """Messages of the file that the example writes, run as the manual says."""
    reader = pytest.importorskip("mcap.reader")
    ros2 = pytest.importorskip("mcap_ros2.decoder")
    path = folder.with_suffix(".mcap")
    words = [sys.executable, str(root / "examples" / "ros2_mcap.py"), str(folder), str(path)]
    done = subprocess.run(words, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    with path.open("rb") as file:
        messages = reader.make_reader(file, decoder_factories=[ros2.DecoderFactory()])
        return list(messages.iter_decoded_messages())


def test_an_mcap_file_holds_readings(tmp_path: Path, root: Path) -> None:
    """Heights, contacts and wrench in SI units, as `live` read them."""
    scene = replace(resize(load("prism48", exact=True), 96, 128), layer=Layer(0.2, 0.45, 8.0))
    prepared, finger = virtual_rig(scene)
    with ReadingRecorder(tmp_path / "r", prepared, "virtual") as recorder:
        kept = [one for one in follow(Live(prepared), finger, 12) if recorder.write(one) is None]
    found = _in_mcap(root, tmp_path / "r")
    clouds, contacts, wrenches = (
        [one.decoded_message for one in found if one.channel.topic == topic]
        for topic in ("/heights", "/contacts", "/wrench")
    )
    trusted = [one.reading for one in kept if one.reading.trusted]
    assert len(clouds) == len(contacts) == len(wrenches) == len(trusted) > 6
    for cloud, reading in zip(clouds, trusted, strict=True):
        points = np.frombuffer(cloud.data, "<f4").reshape(cloud.height, cloud.width, 4)
        np.testing.assert_allclose(1e3 * points[..., 2], np.where(reading.good, reading.z, np.nan), atol=1e-7)
        assert [field.name for field in cloud.fields] == ["x", "y", "z", "sigma"]
        assert cloud.header.frame_id == "mirror"
    reading, wrench, contact = trusted[-1], wrenches[-1].wrench, contacts[-1]
    (force,), (touch,) = reading.forces, reading.touches
    moment = np.cross([1e-3 * touch.x, 1e-3 * touch.y, 0], [0, 0, force.newton])
    assert wrench.force.z == pytest.approx(force.newton)
    assert [wrench.torque.x, wrench.torque.y, wrench.torque.z] == pytest.approx(list(moment))
    values = dict(
        zip([field.name for field in contact.fields], np.frombuffer(contact.data, "<f4"), strict=True)
    )
    assert values["z"] == pytest.approx(1e-3 * touch.depth)
    assert values["force"] == pytest.approx(force.newton)


def test_an_mcap_file_holds_what_a_recording_holds(tmp_path: Path, root: Path) -> None:
    """Read back by the format's own packages, which decode the ROS 2 messages by the schemas in the file."""
    images = recorded(tmp_path / "r")
    found = _in_mcap(root, tmp_path / "r")
    offset = Recording(tmp_path / "r").about["wall_less_monotonic_s"]
    assert offset + time.monotonic() == pytest.approx(time.time(), abs=60)
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
        assert ros.header.stamp.sec + 1e-9 * ros.header.stamp.nanosec == pytest.approx(
            offset + image.arrived_s - 1
        )
        assert one.message.log_time == pytest.approx(1e9 * (image.arrived_s - 1 + offset), abs=1e3)
        assert one.message.sequence == image.id


def test_what_is_alike_takes_little_room(tmp_path: Path) -> None:
    """Photon noise about a still picture: the entropy of the differences; of 8 and of 16 bits, over key
    images, and images of other sizes among them, bit by bit."""
    rng = np.random.default_rng(0)
    mean = 120 + 100 * np.cos(np.arange(96) / 5)[:, None] * np.cos(np.arange(128) / 5)
    for kind, scale in ((np.uint8, 1), (np.uint16, 16)):
        noisy = [np.rint(scale * rng.normal(mean, 1.5)).clip(0).astype(kind) for _ in range(40)]
        noisy[20:20] = [noisy[0][:9, :7]]
        with Recorder(tmp_path / kind.__name__, {}) as recorder:
            for k, pixels in enumerate(noisy):
                recorder.image(Image(pixels, k, None, k / 10), k / 10)
        for pixels, one in zip(noisy, Recording(tmp_path / kind.__name__).images(), strict=True):
            np.testing.assert_array_equal(one.image.pixels, pixels)
            assert one.image.pixels.dtype == kind
        entropy = np.log2(1.5 * scale * np.sqrt(2 * 2 * np.pi * np.e))
        size = (tmp_path / kind.__name__ / "frames.zst").stat().st_size
        keys = 6 * mean.size * np.dtype(kind).itemsize
        assert size < keys + 1.25 * 35 * mean.size * entropy / 8


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


def test_a_writer_that_fails_is_closed_and_says_why() -> None:
    """Whatever ends it: nobody waits for ever for room in its queue."""

    class Broken(Recorder):
        def __init__(self) -> None: ...

        def image(self, *_: object) -> None:
            raise ValueError("pixels of another kind")

    writer = BackgroundRecorder(Broken(), image_bytes=1 << 30)  # room for one
    image = Image(np.zeros((2, 2), np.uint8), 1, None, 0.0)
    with suppress(ValueError):
        for _ in range(3):
            writer.image(image, 0.0)
    closing = threading.Thread(target=writer.close, daemon=True)
    closing.start()
    closing.join(60)
    assert not closing.is_alive()
    assert "another kind" in str(writer.failure)


def test_damage_is_told(tmp_path: Path) -> None:
    with Recorder(tmp_path / "r", {}) as recorder:
        for k in range(3):
            recorder.image(Image(np.full((6, 8), k, np.uint8), k, None, 0.0), 0.0)
    log = tmp_path / "r" / "log.jsonl"
    whole = log.read_bytes()
    log.write_bytes(whole[:-20])  # broken off in the last line: that image does not exist
    assert len(list(Recording(tmp_path / "r"))) == 2
    about, first, *rest = whole.splitlines(keepends=True)

    def changed(name: str, value: object) -> bytes:
        return json.dumps({**json.loads(first), name: value}).encode() + b"\n"

    for line, words in (
        (changed("crc32", 1), "page 0 is damaged"),
        (changed("at", 9999), "page 0 is missing"),
        (b"\xff\n" + first, r"log\.jsonl: line 2 is damaged, 3 lines follow"),
        (b"", r"log\.jsonl: line 2 is missing"),
        (rest[0] + first, r"log\.jsonl: line 2 is missing"),
        (first + first, r"log\.jsonl: line 3 has been moved"),
        (changed("line", [1]), r"log\.jsonl: line 2\.line is \[1\], must be a whole number"),
        (changed("id", "7"), r"log\.jsonl: line 2\.id is '7', must be a whole number"),
        (changed("bytes", True), r"log\.jsonl: line 2\.bytes is True, must be a whole number"),
        (changed("bits", 12), r"log\.jsonl: line 2\.bits is 12, must be 8 or 16"),
        (changed("at", -1), r"log\.jsonl: page 0: at -1, .*: no place of an image"),
        (changed("stamp_s", None), r"log\.jsonl: line 2\.stamp_s is None, must be a number"),
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
