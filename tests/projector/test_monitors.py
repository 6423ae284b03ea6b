"""Monitors: EDID bytes, choice by name, faults; plugged, unplugged and bent ones on Xorg's dummy."""

import os
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from optolever import InputError
from optolever.projector import Monitor, choose_monitor, parse_edid
from optolever.projector.monitors import identified

#: A base block as monitors send it: DEL, "DELL U2412M", "YMYH1234ABCD", 1920 x 1200, 518 x 324 mm.
EDID = bytes.fromhex(
    "00ffffffffffff0010ac7aa04c4b4a30 1b160104a5342078 3a ee95a3544c99260f5054 a54b008180a940d100714f"
    "0101010101010101 283c80a070b023403020360006442100001a 000000ff00594d59483132333441424344"
    "0a 000000fc0044454c4c2055323431324d 0a20 000000fd00323d1e5311000a202020202020 00".replace(" ", "")
)
CONFIGURATION = """
Section "Device"
  Identifier "d"
  Driver "dummy"
  VideoRam 256000
EndSection
Section "Monitor"
  Identifier "m"
  HorizSync 5-1000
  VertRefresh 5-200
  Modeline "1280x720_60" 74.48 1280 1336 1472 1664 720 721 724 746
  Modeline "800x480_60" 29.58 800 816 896 992 480 481 484 497
EndSection
Section "Screen"
  Identifier "s"
  Device "d"
  Monitor "m"
  DefaultDepth 24
  SubSection "Display"
    Depth 24
    Modes "1280x720_60"
    Virtual 2560 1440
  EndSubSection
EndSection
Section "ServerFlags"
  Option "AutoAddDevices" "false"
  Option "AutoAddGPU" "false"
EndSection
"""


def block() -> bytes:
    """The bytes with the sum that they must have."""
    data = EDID[:126] + b"\0"
    return data + bytes([-sum(data) % 256])


def test_an_edid_tells_who_and_how_large() -> None:
    found = parse_edid(block())
    assert (found.maker, found.name, found.serial) == ("DEL", "DELL U2412M", "YMYH1234ABCD")
    assert (found.rows, found.cols) == (1200, 1920)
    assert (found.height_mm, found.width_mm) == (324, 518)


def test_damaged_edids_are_refused() -> None:
    data = block()
    for broken in (data[:100], b"\1" + data[1:], data[:60] + bytes([data[60] ^ 4]) + data[61:]):
        with pytest.raises(InputError, match=r"^EDID: "):
            parse_edid(broken)


def test_the_kernel_and_the_window_system_name_one_connector(tmp_path: Path) -> None:
    for connector, content in (("card0-HDMI-A-1", block()), ("card0-DP-1", b"")):
        (tmp_path / connector).mkdir()
        (tmp_path / connector / "edid").write_bytes(content)
    plain = {"index": 0, "name": "HDMI-1", "output": "HDMI-1", "rows": 1080, "cols": 1920, "refresh_hz": 60}
    seen = identified(plain, tmp_path)
    assert seen.address == "DELL U2412M:YMYH1234ABCD"
    assert (seen.rows_mm, seen.cols_mm) == (324, 518)
    assert any("1080 x 1920 on a panel of 1200 x 1920" in fault for fault in seen.faults())
    assert identified({**plain, "output": "DP-1"}, tmp_path).name == "HDMI-1"


def test_monitors_are_chosen_by_name_never_by_luck() -> None:
    one, two = Monitor(0, "A", 10, 10, 60, "DP-1"), Monitor(1, "A", 10, 10, 60, "DP-2", serial="7")
    assert choose_monitor([one, two], "A:7") is two
    assert choose_monitor([one, two], "DP-1") is one
    with pytest.raises(InputError, match="2 monitors are called 'A'; name the output: DP-1, DP-2"):
        choose_monitor([one, two], "A")
    with pytest.raises(InputError, match="'B' is not connected, there is A, A:7"):
        choose_monitor([one, two], "B")


@pytest.fixture(scope="module")
def dummy(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """Display of an Xorg whose monitors can be plugged, and bend; skips where there is none."""
    if shutil.which("Xorg") is None or shutil.which("xrandr") is None:
        pytest.skip("Xorg is absent (Debian: xserver-xorg-core xserver-xorg-video-dummy x11-xserver-utils)")
    folder = tmp_path_factory.mktemp("dummy")
    (folder / "dummy.conf").write_text(CONFIGURATION)
    read, write = os.pipe()
    words = ["Xorg", "-displayfd", str(write), "-config", str(folder / "dummy.conf"), "-noreset"]
    words += ["-logfile", str(folder / "log"), "-nolisten", "tcp", "-novtswitch", "-sharevts"]
    with subprocess.Popen(
        words, pass_fds=[write], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    ) as server:
        os.close(write)
        with os.fdopen(read) as stream:
            number = stream.readline().strip()
        if not number:
            pytest.skip("Xorg with the driver dummy does not start here (needs root and its Debian package)")
        try:
            yield f":{number}"
        finally:
            server.terminate()


def optolever(display: str, *words: str) -> "subprocess.CompletedProcess[str]":
    return subprocess.run(
        [sys.executable, "-c", RUN, *words],
        env={**os.environ, "DISPLAY": display}, capture_output=True, text=True, check=False, timeout=60,
    )  # fmt: skip


RUN = "import sys; from optolever.cli import run; sys.exit(run(sys.argv[1:]))"


def xrandr(display: str, *words: str) -> None:
    subprocess.run(
        ["xrandr", *words], env={**os.environ, "DISPLAY": display}, check=True, capture_output=True
    )


def plug(display: str) -> None:
    """Connect the second output. GLFW asks for what the server knows; a query makes it look."""
    xrandr(display, "--addmode", "DUMMY1", "800x480_60")
    xrandr(display, "--output", "DUMMY1", "--mode", "800x480_60", "--right-of", "DUMMY0")
    xrandr(display)
    assert "480x800" in optolever(display, "show", "--list").stdout


@pytest.mark.slow
def test_bent_levels_are_told(dummy: str) -> None:
    assert "bends" not in optolever(dummy, "show", "--list").stderr
    xrandr(dummy, "--output", "DUMMY0", "--gamma", "1:0.8:0.55", "--brightness", "0.9")
    try:
        assert "the graphics card bends the levels of DUMMY0" in optolever(dummy, "show", "--list").stderr
        assert "bends the levels of DUMMY0" in " ".join(optolever(dummy, "doctor").stdout.split())
    finally:
        xrandr(dummy, "--output", "DUMMY0", "--gamma", "1:1:1", "--brightness", "1")


@pytest.mark.slow
def test_a_monitor_that_goes_away_ends_the_show(dummy: str, tmp_path: Path) -> None:
    plug(dummy)
    words = ["show", "--sequence", "phase", "--display", "DUMMY1", "--seconds", "1.5"]
    with subprocess.Popen(
        [sys.executable, "-c", RUN, *words], env={**os.environ, "DISPLAY": dummy},
        cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    ) as process:  # fmt: skip
        time.sleep(18)
        xrandr(dummy, "--output", "DUMMY1", "--off")
        _, err = process.communicate(timeout=60)
    assert process.returncode == 2
    (line,) = err.splitlines()
    assert line.startswith("optolever: display: monitor 1 was disconnected after ")
    assert 0 < int(line.split(" after ")[1].split()[0]) < 24
