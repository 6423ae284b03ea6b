"""The real window, under Xvfb: what the window holds and what the X server's screen holds."""

import os
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from optolever import InputError
from optolever.projector import ContextInfo, monitors

ROWS, COLS = 200, 320


@pytest.fixture(scope="module")
def x_server(tmp_path_factory: pytest.TempPathFactory, gl_info: ContextInfo) -> Iterator[tuple[str, Path]]:
    """(display, folder of its frame buffer file) of a server of our own; skips where nothing can draw."""
    binary = shutil.which("Xvfb")
    if binary is None:
        pytest.skip("Xvfb is absent (Debian: apt-get install xvfb)")
    folder = tmp_path_factory.mktemp("xvfb")
    read, write = os.pipe()
    args = [binary, "-displayfd", str(write), "-screen", "0", f"{COLS}x{ROWS}x24", "-fbdir", str(folder)]
    with subprocess.Popen(
        [*args, "-nolisten", "tcp"], pass_fds=[write], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    ) as server:
        os.close(write)
        with os.fdopen(read) as stream:
            number = stream.readline().strip()
        try:
            assert number, "Xvfb did not start"
            yield f":{number}", folder
        finally:
            server.terminate()
            server.wait(10)


@pytest.mark.parametrize("mode", ["window", "full-screen"])
def test_window_shows_the_frames(x_server: tuple[str, Path], tmp_path: Path, mode: str) -> None:
    display, folder = x_server
    script = Path(__file__).with_name("show_in_window.py")
    out = tmp_path / "seen.npz"
    start = time.perf_counter()
    run = subprocess.run(
        [sys.executable, script, folder, out, mode],
        env={**os.environ, "DISPLAY": display},
        capture_output=True,
        text=True,
        check=False,
        timeout=60,
    )
    assert run.returncode == 0, run.stderr
    assert time.perf_counter() - start < 60
    with np.load(out) as seen:
        assert seen["monitors"].tolist() == [[ROWS, COLS]]
        assert seen["indices"].tolist() == [0, 1, 2, 3]  # steps, then what the keys asked for
        expected = seen["expected"]
        if mode == "window":
            np.testing.assert_array_equal(seen["windows"], expected)
        else:
            padded = np.pad(expected, ((0, 0), (0, ROWS - 48), (0, COLS - 80)))
            np.testing.assert_array_equal(seen["windows"], padded)
            np.testing.assert_array_equal(seen["screens"], padded)
        for screen, image in zip(seen["screens"], expected, strict=True):
            assert_holds(screen, image)


def assert_holds(screen: np.ndarray, image: np.ndarray) -> None:
    """The screen shows the image somewhere and is black elsewhere."""
    assert screen.sum(dtype=int) == image.sum(dtype=int)
    if image.any():
        top, left = (int(axis.min()) for axis in np.nonzero(screen))
        first_row, first_col = (int(axis.min()) for axis in np.nonzero(image))
        rows, cols = image.shape
        top, left = top - first_row, left - first_col
        np.testing.assert_array_equal(screen[top : top + rows, left : left + cols], image)


def test_without_a_display_one_line_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    if sys.platform != "linux":
        pytest.skip("DISPLAY decides on Linux only")
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    with pytest.raises(InputError, match=r"^display: GLFW cannot start"):
        monitors()
