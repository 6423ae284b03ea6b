"""One small run of the demo, and a browser to open their reports in."""

from collections.abc import Callable
from pathlib import Path

import pytest

from optolever.samples import DemoResult, run_demo

from ..cli.chromium import printed

Browser = Callable[..., str]


@pytest.fixture(scope="session")
def demo() -> DemoResult:
    """A Gaussian dent, 96 x 96, drawn by NumPy so that no OpenGL is needed."""
    return run_demo("paper-simulation", "gaussian", size=(96, 96), renderer="numpy", seed=3)


@pytest.fixture
def browser(tmp_path: Path) -> Browser:
    """Opens a page in headless Chromium with more options; returns its output."""
    return lambda page, *options: printed(page.as_uri(), tmp_path / "profile", *options)
