"""A rig's camera as readings: its rest measured once, used again, named where it no longer holds; outlets."""

import csv
import json
import socket
import struct
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from threading import Thread
from typing import Any

import numpy as np
import pytest

from optolever import InputError, live
from optolever.camera import Recording
from optolever.camera.cameras import StillCamera
from optolever.live import ReadingRecorder, ReadingSocket, kept_rest, virtual_rig
from optolever.projector import WHITE_NOISE_SENSOR, Image
from optolever.scene import Accuracy, Layer, Scene, load, resize


@pytest.fixture
def rig(tmp_path: Path) -> Path:
    scene = replace(resize(load("prism48"), 96, 128), dent="flat", sensor=WHITE_NOISE_SENSOR)
    return _saved(scene, tmp_path / "rig.toml")


def _saved(scene: Scene, path: Path) -> Path:
    scene.save(path)
    with path.open("a") as file:
        file.write('\n[devices]\ncamera = "virtual"\nfps = 200\n')
    return path


def test_a_rest_is_measured_once(rig: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Then it is used without another; of a picture that has moved it is named, and measured anew."""
    with live.open(rig) as readings:
        first = next(iter(readings))
        assert first.trusted
        assert readings.delay > 0
    assert kept_rest(rig).is_file()
    with monkeypatch.context() as patch:
        patch.setattr("optolever.live.open_rig.decode", None)  # else it would be called
        with live.open(rig) as readings:
            assert not readings.notices
            assert next(iter(readings)).trusted
        replace(load(rig), accuracy=Accuracy(scale=0.05, edge=0.02)).save(rig)
        with live.open(rig) as readings:  # with the errors in the file
            assert next(iter(readings)).total_sigma.min() > 0.02
            assert readings.prepared.error is not None
            assert readings.prepared.error > 0.02
    following = StillCamera.next

    def bumped(camera: StillCamera, timeout_s: float) -> Image | None:
        image = following(camera, timeout_s)
        if image is None:
            return None
        moved = np.pad(image.pixels[:, :-2], ((0, 0), (2, 0)), mode="edge")  # np.roll would tear the frame
        return replace(image, pixels=moved)

    monkeypatch.setattr(StillCamera, "next", bumped)
    kept = live.Prepared.load(kept_rest(rig))
    with pytest.raises(InputError, match="rest: no longer holds"), live.open(rig, kept):
        pass
    with live.open(rig) as readings:
        said = str(readings.notices[-1])
        assert "rig.live.npz no longer holds: the picture has moved as a whole" in said
        assert next(iter(readings)).trusted


def test_a_finger_presses_on_the_mirror_of_a_virtual_camera(tmp_path: Path) -> None:
    """Unless its scene has a dent; it slides, and its depth is that of the mirror in that frame."""
    scene = replace(resize(load("prism48"), 96, 128), dent=None, layer=Layer(0.2, 0.5, 8.0))
    places, depths, forces = list[float](), list[tuple[float, float]](), list[float]()
    with live.open(_saved(scene, tmp_path / "rig.toml")) as readings:
        finger = readings.source
        assert isinstance(finger, live.VirtualFinger)
        for followed in live.follow(live.Live(readings.prepared), finger, 30):
            reading = followed.reading
            assert reading.trusted
            for touch, force in zip(reading.touches, reading.forces, strict=True):
                true = finger.surface(followed.image.id or 0).height(reading.x, reading.y).max()
                depths.append((touch.depth, true))
                places.append(touch.x)
                forces.append(force.newton)
    found, true = np.transpose(depths)
    assert len(found) > 15
    assert np.abs(found - true).max() < 0.03 * true.max()
    assert np.ptp(places) > 3
    assert max(forces) > 0.1
    _saved(replace(scene, dent="flat"), tmp_path / "still.toml")
    with live.open(tmp_path / "still.toml") as readings:
        assert not isinstance(readings.source, live.VirtualFinger)


def test_a_display_may_be_slow_to_show_the_fringe(rig: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with live.open(rig) as readings:
        prepared = readings.prepared
    following, dark = StillCamera.next, 20

    def late(camera: StillCamera, timeout_s: float) -> Image | None:
        nonlocal dark
        image, dark = following(camera, timeout_s), dark - 1
        return image if image is None or dark < 0 else replace(image, pixels=np.zeros_like(image.pixels))

    monkeypatch.setattr(StillCamera, "next", late)
    with live.open(rig, prepared) as readings:
        assert next(iter(readings)).trusted


def test_a_rest_of_one_image_several_times_has_its_noise(tmp_path: Path) -> None:
    """The simulated camera repeats photons; another picture of the same mirror has others."""
    rig = _saved(replace(resize(load("prism48"), 96, 128), dent="flat"), tmp_path / "rig.toml")
    for _ in range(2):
        with live.open(rig) as readings:
            assert not readings.notices
            assert next(iter(readings)).trusted


def test_a_rest_of_another_geometry_is_not_used(rig: Path) -> None:
    with live.open(rig) as readings:
        prepared = readings.prepared
    scene = load(rig)
    x, y, z = scene.pattern.origin
    replace(scene, pattern=replace(scene.pattern, origin=(x, y, z + 0.2))).save(rig)
    with pytest.raises(InputError, match="geometry has changed"), live.open(rig, prepared):
        pass


def test_a_recording_is_a_rig_s_camera(tmp_path: Path) -> None:
    """With the rest that it holds: the readings of the recording, to its end; contacts as lines of CSV."""
    scene = replace(resize(load("prism48", exact=True), 96, 128), layer=Layer(0.2, 0.45, 8.0))
    prepared, finger = virtual_rig(scene)
    with ReadingRecorder(tmp_path / "film", prepared, "virtual") as recorder:
        kept = [one for one in live.follow(live.Live(prepared), finger, 20) if recorder.write(one) is None]
    path = _saved(scene, tmp_path / "rig.toml")
    changes = ["camera=replay:" + str(tmp_path / "film")]
    table = tmp_path / "contacts.csv"
    with (
        live.open(path, live.Prepared.load(tmp_path / "film" / "prepared.npz"), changes=changes) as readings,
        live.ContactTable(table) as contacts,
    ):
        for followed in readings.followed():
            contacts.write(followed)
            recorded = Recording(tmp_path / "film").about["wall_less_monotonic_s"]
            assert followed.wall == pytest.approx(followed.reading.time + recorded, abs=1e-5)
    rows = list(csv.DictReader(table.read_text().splitlines()))
    pressed = [one for one in kept[1:] if one.reading.touches]
    found = [row for row in rows if row["contact"]]
    assert len(found) == sum(len(one.reading.touches) for one in pressed) > 5
    for row, one in zip(found, pressed, strict=True):
        assert float(row["depth_mm"]) == pytest.approx(one.reading.touches[0].depth, rel=0.01)
        assert float(row["force_n"]) == pytest.approx(one.reading.forces[0].newton, rel=0.05)
        assert float(row["time_s"]) == pytest.approx(one.reading.time, abs=1e-5)
    assert any(not row["contact"] for row in rows)


def test_a_socket_sends_whole_heights(tmp_path: Path) -> None:
    """As the manual reads it; the program ends without a reader, or with one that reads no more."""
    prepared, finger = virtual_rig(resize(load("prism48", exact=True), 96, 128))
    seen = []

    def read() -> None:
        with socket.socket(socket.AF_UNIX) as reader:
            reader.connect(str(tmp_path / "s"))
            stream = reader.makefile("rb")
            while line := stream.readline():
                numbers = json.loads(line)
                z = np.frombuffer(stream.read(numbers["bytes"]), "<f4")
                seen.append((numbers, z.reshape(numbers["rows"], numbers["cols"])))

    with ReadingSocket(tmp_path / "s") as sender:
        thread = Thread(target=read)
        thread.start()
        followed = None
        for followed in live.follow(live.Live(prepared), finger, 12):
            sender.write(followed)
        with pytest.raises(InputError, match="no socket can be made"):
            ReadingSocket(tmp_path / "s")
    thread.join(timeout=60)
    assert followed is not None
    numbers, z = seen[-1]
    assert numbers["frame"] == followed.image.id
    np.testing.assert_array_equal(z, np.where(followed.reading.good, followed.reading.z, np.nan))
    assert numbers["x_mm"] == pytest.approx([followed.reading.x[24, 0], followed.reading.x[24, -1]])
    assert not (tmp_path / "s").exists()
    with ReadingSocket(tmp_path / "s"):
        (tmp_path / "s").rename(tmp_path / "aside")
        (tmp_path / "s").write_text("of somebody else")
    assert (tmp_path / "s").read_text() == "of somebody else"


def test_foxglove_hears_of_a_contact(tmp_path: Path) -> None:
    """The example, and a client of Foxglove's websocket."""
    for package in ("foxglove", "websockets"):
        pytest.importorskip(package, reason="foxglove-sdk and websockets: pip install -e .[dev]")
    from websockets.sync.client import connect

    scene = replace(resize(load("prism48"), 96, 128), dent=None, layer=Layer(0.2, 0.5, 8.0))
    program = Path(__file__).parents[2] / "examples" / "foxglove_live.py"
    words = [sys.executable, str(program), str(_saved(scene, tmp_path / "rig.toml")), "0"]
    with subprocess.Popen(words, stdout=subprocess.PIPE, text=True) as server:
        try:
            assert server.stdout is not None
            address = server.stdout.readline().strip()
            with connect(address, subprotocols=["foxglove.sdk.v1"]) as client:
                channels: list[dict[str, Any]] = []
                while not channels:
                    message = client.recv(timeout=60)
                    channels = json.loads(message).get("channels", []) if isinstance(message, str) else []
                wanted = [{"id": 7, "channelId": one["id"]} for one in channels if one["topic"] == "/reading"]
                client.send(json.dumps({"op": "subscribe", "subscriptions": wanted}))
                touches: list[Any] = []
                while not touches:
                    message = client.recv(timeout=60)
                    if isinstance(message, bytes):
                        operation, subscription, log_time = struct.unpack_from("<BIQ", message)
                        reading = json.loads(message[13:])
                        touches = reading["touches"]
        finally:
            server.kill()
    assert (operation, subscription) == (1, 7)
    assert 1e-9 * log_time == pytest.approx(reading["wall_s"], abs=1e-5)
    assert reading["forces"][0]["newton"] > 0
    assert touches[0]["depth"] > 0
