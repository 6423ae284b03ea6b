"""The live page: its answers, its commands, who may ask; the program's lines of JSON; Chromium draws it."""

import contextlib
import csv
import io
import json
import re
import socket
import struct
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

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
    replayed,
    tared,
    virtual_rig,
)
from optolever.projector import Image
from optolever.scene import load, resize

from ..cli.chromium import asked, printed

Virtual = tuple[Prepared, VirtualFinger]


@pytest.fixture(scope="module")
def virtual() -> Virtual:
    return virtual_rig(resize(load("prism48", exact=True), 96, 128))


class _Rest:
    """A camera that sees the mirror at rest, 200 times a second."""

    def __init__(self, finger: VirtualFinger) -> None:
        self._frames, self._count = finger.at_rest(), 0

    def next(self, timeout_s: float) -> Image | None:
        self._count += 1
        time.sleep(0.005)  # without it the threads of the readings and the server hardly run
        return Image(self._frames[self._count % len(self._frames)], self._count, None, self._count / 1e5)


def test_a_virtual_camera_that_waited_does_not_catch_up() -> None:
    finger = virtual_rig(resize(load("prism48", exact=True), 96, 128), rate=25.0)[1]
    arrived = [image.arrived_s for _ in range(4) if (image := finger.next(1.0))]
    assert len(arrived) == 4
    assert np.diff(arrived).min() > 0.0399


@pytest.fixture
def server(virtual: Virtual) -> Iterator[LiveServer]:
    with LiveServer(virtual[0], _Rest(virtual[1])) as live:
        yield live


def _ask(server: LiveServer, path: str, method: str = "GET", **headers: str) -> tuple[int, bytes]:
    return asked(server.address, path, method, **headers)


def _token(server: LiveServer) -> dict[str, str]:
    found = re.search(rb'name="token" content="([^"]+)"', _ask(server, "/")[1])
    assert found
    return {"X-Optolever-Token": found[1].decode()}


def _sent(server: LiveServer, data: bytes) -> bytes:
    """All that comes back on one connection until the server closes it."""
    port = int(server.address.rstrip("/").rpartition(":")[2])
    with socket.create_connection(("127.0.0.1", port), timeout=60) as connection:
        connection.sendall(data)
        return b"".join(iter(lambda: connection.recv(4096), b""))


def _numbers(server: LiveServer, after: int) -> dict[str, Any]:
    return dict(json.loads(_parts(_ask(server, f"/next?after={after}")[1])[0]))


def _parts(body: bytes) -> list[bytes]:
    parts = io.BytesIO(body)
    lengths = struct.unpack("<4I", parts.read(16))
    return [parts.read(length) for length in lengths]


def test_the_page_asks_for_one_reading_after_the_other(server: LiveServer) -> None:
    status, page = _ask(server, "/")
    assert status == 200
    assert b"<canvas" in page
    for path in set(re.findall(rb'(?:src|href)="(/[^"]+)"', page)) - {b"/snapshot"}:
        status, text = _ask(server, path.decode())
        assert status == 200
        assert b"http://" not in text.replace(b"http://www.w3.org", b"")  # nothing from outside
        assert b"https://" not in text.replace(b"https://github.com/leeoniya/uPlot", b"")
    status, body = _ask(server, "/next?after=0")
    state, camera, sigma, height = _parts(body)
    numbers = json.loads(state)
    assert numbers["trusted"]
    assert np.frombuffer(height, np.float32).size == numbers["rows"] * numbers["cols"]
    assert camera[:2] == b"\xff\xd8"
    assert np.nanmedian(np.frombuffer(sigma, np.float32)) == pytest.approx(numbers["sigma_um"], rel=0.2)
    assert _numbers(server, numbers["count"])["count"] > numbers["count"]
    with np.load(io.BytesIO(_ask(server, "/snapshot")[1])) as kept:
        assert kept["z"].shape == kept["sigma"].shape == kept["good"].shape
        assert kept["frame"].shape == (96, 128)
        assert json.loads(str(kept["numbers"]))["trusted"]


def test_other_sites_may_neither_read_nor_steer(server: LiveServer) -> None:
    token, evil = _token(server), {"Origin": "http://evil.example"}
    for status, path, method, headers in (
        (403, "/", "GET", {"Host": "evil.example:80"}),
        (403, "/next?after=0", "GET", evil),
        (403, "/next?after=0", "GET", {"Sec-Fetch-Site": "cross-site"}),
        (403, "/tare", "POST", evil | token),
        (403, "/tare", "POST", {"X-Optolever-Token": "0"}),
        (404, "/format", "POST", token),
        (405, "/tare", "GET", {}),
    ):
        assert _ask(server, path, method, **headers)[0] == status
    assert _numbers(server, 0)["answer"] == ""


@pytest.mark.parametrize("method", ["POST", "GET"])
def test_a_body_is_no_second_request(server: LiveServer, method: str) -> None:
    """What a refused request carries is not executed: one refusal, and the connection is closed."""
    host = server.address.removeprefix("http://").rstrip("/")
    held = f"Host: {host}\r\nX-Optolever-Token: {_token(server)['X-Optolever-Token']}\r\n\r\n"
    body = f"POST /tare HTTP/1.1\r\n{held}"
    head = f"{method} /tare HTTP/1.1\r\nContent-Length: {len(body)}\r\nOrigin: http://evil.example\r\n"
    answer = _sent(server, f"{head}Host: {host}\r\n\r\n{body}".encode())
    assert answer.count(b"HTTP/1.1 ") == 1
    assert answer.startswith(b"HTTP/1.1 403")
    assert _numbers(server, server.readings)["answer"] == ""


def test_odd_clients_leave_no_trace(server: LiveServer, capfd: pytest.CaptureFixture[str]) -> None:
    """A number of 5,000 digits, nonsense, resets in the middle of an answer, more clients than 16."""
    port = int(server.address.rstrip("/").rpartition(":")[2])
    status, answer = _ask(server, "/next?after=" + "9" * 5000)
    assert (status, b"after" in answer) == (400, True)
    assert _sent(server, b"\x16\x03\x01 nonsense\r\n\r\n").startswith(b"HTTP/1.1 400")
    for _ in range(20):
        with socket.create_connection(("127.0.0.1", port)) as one:
            one.sendall(f"GET /next?after=0 HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\n\r\n".encode())
            one.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
    with contextlib.ExitStack() as stack:
        for _ in range(40):
            stack.enter_context(socket.create_connection(("127.0.0.1", port)))
        assert _ask(server, "/")[0] == 503
    until = time.monotonic() + 60
    while _ask(server, "/")[0] != 200:
        assert time.monotonic() < until
    assert capfd.readouterr() == ("", "")


def test_connections_without_a_request_are_closed(server: LiveServer) -> None:
    """Silent ones, and ones that send a byte now and then; the page's own stays while it asks."""
    port, start = int(server.address.rstrip("/").rpartition(":")[2]), time.monotonic()
    with socket.create_connection(("127.0.0.1", port), timeout=60) as silent:
        with socket.create_connection(("127.0.0.1", port), timeout=60) as slow:
            for byte in b"GET / ":
                slow.sendall(bytes([byte]))
                time.sleep(0.6)
            assert slow.recv(1) == b""
        assert silent.recv(1) == b""
    assert 4 < time.monotonic() - start < 30


def test_a_click_sets_a_probe_and_a_button_records(
    server: LiveServer, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    token = _token(server)
    for at in ("0.5,0.5", "0.25,0.75"):
        assert _ask(server, f"/probe?at={at}", "POST", **token) == (200, b"")
    assert _ask(server, "/probe?at=2,x", "POST", **token)[0] == 400
    assert b"must be on the part of the mirror" in _ask(server, "/probe?at=0,0", "POST", **token)[1]
    _ask(server, "/record", "POST", **token)
    until = server.readings + 20
    while server.readings < until:
        time.sleep(0.02)
    assert server.command("tare") == "tare refused: it would change the rest of the recording"
    numbers = _numbers(server, server.readings)
    assert np.allclose(numbers["places"], [(0.5, 0.5), (0.25, 0.75)], atol=0.02)
    assert all(probe["sigma"] > 0 for probe in numbers["probes"])
    assert numbers["recording"].startswith("live-")
    until = time.monotonic() + 60
    while not all(spectra := _numbers(server, server.readings)["spectra"]):
        assert time.monotonic() < until
    assert all(one["floor_nm"] > 0 for one in spectra)
    assert b"frames recorded in live-" in _ask(server, "/record", "POST", **token)[1]
    again = list(replayed(tmp_path / numbers["recording"]))
    assert len(again) > 5
    assert all(one.identical for one in again)
    assert _ask(server, "/clear?probe=x", "POST", **token)[0] == 400
    _ask(server, "/clear?probe=1", "POST", **token)
    assert np.allclose(_numbers(server, server.readings)["places"], [(0.25, 0.75)], atol=0.02)
    _ask(server, "/clear", "POST", **token)
    assert _numbers(server, server.readings)["probes"] == []


def test_a_camera_that_stops_or_fails_is_numbers(virtual: Virtual) -> None:
    """The age of the picture grows."""
    prepared, finger = virtual
    images = iter([Image(finger.at_rest()[0], 0, None, time.monotonic())])
    with LiveServer(prepared, SimpleNamespace(next=lambda timeout_s: next(images, None))) as live:
        _ask(live, "/next?after=0")
        assert _ask(live, "/next?after=1")[0] == 204
        assert _numbers(live, 0)["age_s"] > 1

    def broken(timeout_s: float) -> Image | None:
        raise OSError("unplugged")

    with LiveServer(prepared, SimpleNamespace(next=broken)) as live:
        assert _ask(live, "/next?after=0") == (503, b"unplugged")
        assert live.error == "unplugged"


def test_tare_makes_a_new_zero_and_is_refused_while_touched(virtual: Virtual) -> None:
    prepared, finger = virtual
    pressed = next(one for one in follow(Live(prepared), finger) if one.reading.depth > 0.02)
    zero = tared(prepared, np.stack([pressed.image.pixels] * 4))
    assert Live(zero).update(pressed.image.pixels).deepest is None
    with LiveServer(prepared, SimpleNamespace(next=lambda timeout_s: pressed.image)) as touched:
        _ask(touched, "/next?after=0")
        assert b"refused" in _ask(touched, "/tare", "POST", **_token(touched))[1]
    with LiveServer(zero, _Rest(finger)) as other:
        _ask(other, "/next?after=0")
        assert _ask(other, "/tare", "POST", **_token(other))[1] == b"tare: hold still"
        while _numbers(other, other.readings)["answer"] == "tare: hold still":
            pass
        assert _numbers(other, other.readings)["answer"] == "tared"


def test_a_slow_reader_gets_the_newest_frame(virtual: Virtual) -> None:
    with Newest(_Rest(virtual[1])) as source:
        first, later = source.next(5.0), None
        while later is None or source.skipped == 0:
            time.sleep(0.03)
            later = source.next(5.0)
    assert first is not None
    assert (later.id or 0) > (first.id or 0)


def test_lines_of_json_and_the_numbers_of_the_run(
    capfd: pytest.CaptureFixture[str], tmp_path: Path, refused: Callable[..., str]
) -> None:
    args = ["live", "--pixels", "128x96", "--rate", "0", "--headless", "--frames", "20", "--probe", "24,22"]
    outlets = ["--csv", str(tmp_path / "c.csv"), "--socket", str(tmp_path / "s")]
    assert run([*args, "--json-lines", "--json", str(tmp_path / "run.json"), *outlets]) == 0
    lines = [json.loads(line) for line in capfd.readouterr().out.splitlines()]
    assert [line["frame"] for line in lines] == list(range(20))
    assert all(line["trusted"] for line in lines)
    assert max(line["depth_mm"] or 0 for line in lines) > 0.02
    assert lines[0]["depth_mm"] is None
    assert all(line["probes"][0]["sigma"] > 0 for line in lines)
    rows = list(csv.DictReader((tmp_path / "c.csv").read_text().splitlines()))
    assert len(rows) == 20
    for line, row in zip(lines, rows, strict=True):
        assert abs(time.time() - line["wall_s"]) < 3600
        assert float(row["wall_s"]) == pytest.approx(line["wall_s"], abs=1e-5)
        assert line["wall_s"] - line["time_s"] == pytest.approx(
            lines[0]["wall_s"] - lines[0]["time_s"], abs=1e-5
        )
    assert max(float(row["depth_mm"] or 0) for row in rows) > 0.02
    assert run([*args[:3], "--frames", "130"]) == 0  # with the page
    out = capfd.readouterr().out
    assert out.count(" nm/sqrt(Hz)") == 2  # once the rate is known, and at the end
    numbers = json.loads((tmp_path / "run.json").read_text())
    assert numbers["readings"] == 20
    assert numbers["probes"][0]["spectrum"]["peak_nm"] > 1000
    refused(["live", "--headless", "--probe", "30"], "--probe '30'", "X,Y")
    refused(["live", "--scene", "none.toml", "--headless"], "none.toml")
    refused([*args, "--csv", tmp_path / "none" / "c.csv"], "none")
    refused([*args, "--rest", "new"], "--rest: needs --rig")


@pytest.mark.slow
def test_chromium_draws_it(virtual: Virtual, tmp_path: Path) -> None:
    with LiveServer(*virtual) as live:
        page = printed(
            live.address, tmp_path, "--enable-logging=stderr", "--virtual-time-budget=4000", "--dump-dom"
        )
    assert "readings/s" in page
    sizes = re.findall(r'id="camera"[^>]*width="(\d+)" height="(\d+)"', page)
    assert [int(cols) / int(rows) for cols, rows in sizes] == [4 / 3]  # of 96 x 128 pixels
    assert page.count('class="uplot') == 5  # charts
