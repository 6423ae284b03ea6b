"""The live page: its answers, its commands, who may ask; the program's lines of JSON; Chromium draws it."""

import http.client
import io
import json
import re
import shutil
import struct
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from optolever.cli import run
from optolever.live import (
    Live,
    LiveServer,
    Newest,
    Prepared,
    VirtualFinger,
    follow,
    tared,
    virtual_rig,
)
from optolever.projector import Image
from optolever.scene import load, resize

Virtual = tuple[Prepared, VirtualFinger]


@pytest.fixture(scope="module")
def virtual() -> Virtual:
    return virtual_rig(resize(load("prism48", exact=True), 96, 128))


class _Rest:
    """A camera that sees the mirror at rest."""

    def __init__(self, finger: VirtualFinger) -> None:
        self._frames, self._count = finger.at_rest(), 0

    def next(self, timeout_s: float) -> Image | None:
        self._count += 1
        return Image(self._frames[self._count % len(self._frames)], self._count, None, float(self._count))


@pytest.fixture
def server(virtual: Virtual) -> Iterator[LiveServer]:
    prepared, finger = virtual
    with LiveServer(prepared, _Rest(finger)) as live:
        yield live


def _ask(server: LiveServer, path: str, method: str = "GET", **headers: str) -> tuple[int, bytes]:
    host = server.address.removeprefix("http://").rstrip("/")
    connection = http.client.HTTPConnection(host, timeout=30)
    connection.request(method, path, headers={"Host": host, **headers})
    answer = connection.getresponse()
    status, body = answer.status, answer.read()
    connection.close()
    return status, body


def _parts(body: bytes) -> list[bytes]:
    lengths = struct.unpack("<4I", body[:16])
    ends = 16 + np.cumsum(lengths)
    assert ends[-1] == len(body)
    return [body[end - length : end] for end, length in zip(ends, lengths, strict=True)]


def test_the_page_asks_for_one_reading_after_the_other(server: LiveServer, virtual: Virtual) -> None:
    status, page = _ask(server, "/")
    assert status == 200
    assert b"<canvas" in page
    assert b"http://" not in page.replace(b"http://www.w3.org", b"")  # nothing from outside
    status, body = _ask(server, "/next?after=0")
    numbers, camera, sigma, height = _parts(body)
    told = json.loads(numbers)
    assert status == 200
    assert told["trusted"]
    assert np.frombuffer(height, np.float32).size == told["rows"] * told["cols"]
    assert camera[:2] == sigma[:2] == b"\xff\xd8"
    status, body = _ask(server, f"/next?after={told['count']}")
    assert json.loads(_parts(body)[0])["count"] > told["count"]


def test_a_snapshot_is_a_reading(server: LiveServer) -> None:
    _ask(server, "/next?after=0")
    _, body = _ask(server, "/snapshot")
    with np.load(io.BytesIO(body)) as kept:
        assert kept["z"].shape == kept["sigma"].shape == kept["good"].shape
        assert kept["frame"].shape == (96, 128)
        assert json.loads(str(kept["numbers"]))["trusted"]


def test_other_sites_may_neither_read_nor_steer(server: LiveServer) -> None:
    assert _ask(server, "/", Host="evil.example:80")[0] == 403
    assert _ask(server, "/next?after=0", Origin="http://evil.example")[0] == 403
    assert _ask(server, "/tare", "POST", Origin="http://evil.example")[0] == 403
    assert _ask(server, "/format", "POST")[0] == 404


def test_pause_holds_the_picture(server: LiveServer) -> None:
    _ask(server, "/next?after=0")
    assert _ask(server, "/pause", "POST")[1] == b"paused"
    held = server.readings
    assert _ask(server, f"/next?after={held + 1}")[0] == 204
    assert server.readings <= held + 1  # one may have been on its way
    _ask(server, "/resume", "POST")
    assert _ask(server, f"/next?after={held + 1}")[0] == 200


def test_tare_makes_a_new_zero_and_is_refused_while_touched(virtual: Virtual) -> None:
    prepared, finger = virtual
    with LiveServer(prepared, _Rest(finger)) as resting:
        _ask(resting, "/next?after=0")
        assert _ask(resting, "/tare", "POST")[1] == b"tare: hold still"
    pressed = next(one for one in follow(Live(prepared), finger) if one.reading.depth > 0.02)

    class Pressed:
        def next(self, timeout_s: float) -> Image | None:
            return pressed.image

    with LiveServer(prepared, Pressed()) as touched:
        _ask(touched, "/next?after=0")
        assert b"refused" in _ask(touched, "/tare", "POST")[1]
    zero = tared(prepared, np.stack([pressed.image.pixels] * 4))
    reading = Live(zero).update(pressed.image.pixels)
    assert abs(reading.depth) < 0.05 * pressed.reading.depth


def test_a_slow_reader_gets_the_newest_frame(virtual: Virtual) -> None:
    with Newest(_Rest(virtual[1])) as source:
        first, later = source.next(5.0), None
        while later is None or source.skipped == 0:
            later = source.next(5.0)
    assert first is not None
    assert (later.id or 0) > (first.id or 0)


def test_a_camera_that_fails_is_told(virtual: Virtual) -> None:
    class Broken:
        def next(self, timeout_s: float) -> Image | None:
            raise OSError("unplugged")

    with LiveServer(virtual[0], Broken()) as live:
        live.answer(0)
        assert live.error == "unplugged"


def test_lines_of_json_and_the_numbers_of_the_run(
    capfd: pytest.CaptureFixture[str], tmp_path: Path, refused: Callable[..., str]
) -> None:
    args = ["live", "--size", "96x128", "--rate", "0", "--headless", "--frames", "12"]
    assert run([*args, "--json-lines", "--json", str(tmp_path / "run.json")]) == 0
    lines = [json.loads(line) for line in capfd.readouterr().out.splitlines()]
    assert [line["frame"] for line in lines] == list(range(12))
    assert all(line["trusted"] for line in lines)
    assert max(line["depth_mm"] for line in lines) > 0.02
    assert json.loads((tmp_path / "run.json").read_text())["readings"] == 12
    refused(["live", "--json-lines"], "--json-lines", "--headless")
    refused(["live", "--scene", "none.toml", "--headless"], "none.toml")


@pytest.mark.slow
def test_chromium_draws_it(virtual: Virtual, tmp_path: Path) -> None:
    path = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
    if path is None:
        pytest.skip("no Chromium on this machine: the page is not opened")
    prepared, finger = virtual
    with LiveServer(prepared, finger) as live:
        flags = ["--headless=new", "--no-sandbox", "--disable-gpu", "--enable-logging=stderr"]
        flags += ["--virtual-time-budget=4000", f"--user-data-dir={tmp_path / 'profile'}"]
        command = [path, *flags, "--dump-dom", live.address]
        done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=120)
    assert "readings/s" in done.stdout
    sizes = re.findall(r'id="(?:camera|trust)"[^>]*width="(\d+)" height="(\d+)"', done.stdout)
    assert [int(cols) / int(rows) for cols, rows in sizes] == [4 / 3, 4 / 3]  # of 96 x 128 pixels
    assert "CONSOLE" not in done.stderr, done.stderr
