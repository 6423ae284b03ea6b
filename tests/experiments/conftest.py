"""One small run of the demo , and a browser to open their reports in."""

import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest

from optolever.experiments import DemoResult, run_demo

FLAGS = [
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--hide-scrollbars",
]
Browser = Callable[..., str]


@pytest.fixture(scope="session")
def demo() -> DemoResult:
    """A Gaussian dent, 96 x 96, drawn by NumPy so that no OpenGL is needed."""
    return run_demo("paper-simulation", "gaussian", size=(96, 96), renderer="numpy", seed=3)


@pytest.fixture
def browser(tmp_path: Path) -> Browser:
    """Opens a page in headless Chromium with more options; gives back what it prints. Skips where there is
    none.
    """
    path = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
    if path is None:
        pytest.skip("no Chromium on this machine: the page is not opened (apt-get install chromium)")

    def open_page(page: Path, *options: str) -> str:
        profile = f"--user-data-dir={tmp_path / 'profile'}"
        command = [path, *FLAGS, profile, *options, page.as_uri()]
        done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=120)
        assert "CONSOLE" not in done.stderr, done.stderr  # messages, with --enable-logging=stderr
        return done.stdout

    return open_page
