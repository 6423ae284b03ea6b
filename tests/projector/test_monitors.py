"""Monitors: choice by name, faults; plugged, unplugged and bent ones on Xorg's dummy."""

import os
import shutil
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from optolever import InputError
from optolever.projector import Monitor, choose_monitor
from optolever.projector.monitors import edid_of

from .conftest import RUN, optolever, x_display

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


def test_monitors_are_chosen_by_name_never_by_luck() -> None:
    one, two = Monitor(0, "A", 10, 10, 60), Monitor(1, "B", 10, 10, 60)
    assert choose_monitor([one, two], "B") is two
    with pytest.raises(InputError, match="2 monitors are called 'A'"):
        choose_monitor([one, one, two], "A")
    with pytest.raises(InputError, match="'C' is not connected, there is A, B"):
        choose_monitor([one, two], "C")


def test_two_monitors_of_one_model_are_told_apart(tmp_path: Path) -> None:
    """By the serial of EDID, as text or number; without, by the output."""
    for output, number, texts in (
        ("DP-1", 0, {0xFC: b"U2412M\n", 0xFF: b"YMYH1\n"}),
        ("HDMI-A-1", 77, {0xFC: b"U2412M\n"}),
        ("DP-2", 0, {0xFC: b"U2412M\n"}),
    ):
        edid = bytearray(128)
        edid[:8], edid[12:16] = bytes([0, *[255] * 6, 0]), number.to_bytes(4, "little")
        for at, (tag, text) in zip((54, 72), texts.items(), strict=False):
            edid[at + 3], edid[at + 5 : at + 5 + len(text)] = tag, text
        folder = tmp_path / f"card1-{output}"
        folder.mkdir()
        (folder / "edid").write_bytes(edid)
    outputs = ("DP-1", "HDMI-1", "DP-2", "VGA-1")
    known = [edid_of(name, tmp_path) for name in outputs]
    assert known == [("U2412M", "YMYH1"), ("U2412M", "77"), ("U2412M", ""), ("", "")]
    found = [
        Monitor(k, name, 10, 10, 60, model=model, serial=serial)
        for k, (name, (model, serial)) in enumerate(zip(outputs, known, strict=True))
    ]
    for text, index in (("U2412M:YMYH1", 0), ("DP-1", 0), ("U2412M:77", 1), ("DP-2", 2), ("VGA-1", 3)):
        assert choose_monitor(found, text).index == index
    with pytest.raises(
        InputError, match="3 monitors are called 'U2412M': name one: U2412M:YMYH1, U2412M:77, DP-2"
    ):
        choose_monitor(found, "U2412M")


@pytest.fixture(scope="module")
def dummy(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """Display of an Xorg whose monitors can be plugged, and bend; skips where there is none."""
    if shutil.which("Xorg") is None or shutil.which("xrandr") is None:
        pytest.skip("Xorg is absent (Debian: xserver-xorg-core xserver-xorg-video-dummy x11-xserver-utils)")
    folder = tmp_path_factory.mktemp("dummy")
    (folder / "dummy.conf").write_text(CONFIGURATION)
    words = ["-config", str(folder / "dummy.conf"), "-logfile", str(folder / "log"), "-noreset"]
    with x_display("Xorg", *words, "-novtswitch", "-sharevts") as display:
        if not display:
            pytest.skip("Xorg with the driver dummy does not start here (needs root and its Debian package)")
        yield display


def xrandr(display: str, *words: str) -> None:
    subprocess.run(
        ["xrandr", *words], env={**os.environ, "DISPLAY": display}, check=True, capture_output=True
    )


def plug(display: str) -> None:
    """Connect the second output. GLFW asks for what the server knows; a query makes it look."""
    xrandr(display, "--addmode", "DUMMY1", "800x480_60")
    xrandr(display, "--output", "DUMMY1", "--mode", "800x480_60", "--right-of", "DUMMY0")
    xrandr(display)
    assert "480 x 800" in optolever(display, "show", "--list").stdout


@pytest.mark.slow
def test_bent_levels_are_told(dummy: str) -> None:
    assert "bends" not in optolever(dummy, "show", "--list").stderr
    xrandr(dummy, "--output", "DUMMY0", "--gamma", "1:0.8:0.55", "--brightness", "0.9")
    try:
        for words in (["show", "--list"], ["doctor"]):
            assert "the graphics card bends the levels of DUMMY0" in optolever(dummy, *words).stderr
    finally:
        xrandr(dummy, "--output", "DUMMY0", "--gamma", "1:1:1", "--brightness", "1")


@pytest.mark.slow
def test_a_monitor_that_goes_away_ends_the_show(dummy: str, tmp_path: Path) -> None:
    plug(dummy)
    words = [*RUN, "show", "--sequence", "phase", "--monitor", "DUMMY1", "--seconds", "1.5"]
    env, pipe = {**os.environ, "DISPLAY": dummy}, subprocess.PIPE
    with subprocess.Popen(words, env=env, cwd=tmp_path, stdout=pipe, stderr=pipe, text=True) as process:
        time.sleep(18)
        xrandr(dummy, "--output", "DUMMY1", "--off")
        _, err = process.communicate(timeout=60)
    assert process.returncode == 2
    (line,) = err.splitlines()
    assert line.startswith("optolever: display: monitor 1 was disconnected after ")
    assert 0 < int(line.split(" after ")[1].split()[0]) < 24
