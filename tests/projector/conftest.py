"""One GL context for the part's tests; errors and forgotten objects fail the test that made them."""

import gc
import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager

import moderngl
import pytest

from optolever.projector import ContextInfo, NoContextError, context_info
from optolever.projector.context import context

RUN = (sys.executable, "-c", "import sys; from optolever.cli import run; sys.exit(run(sys.argv[1:]))")


def optolever(display: str, *words: str) -> "subprocess.CompletedProcess[str]":
    """The program on a display."""
    command, environment = [*RUN, *words], {**os.environ, "DISPLAY": display}
    return subprocess.run(command, env=environment, capture_output=True, text=True, check=False, timeout=300)


@contextmanager
def x_display(*words: str) -> Iterator[str]:
    """Display of an X server of our own; empty where it does not start."""
    read, write = os.pipe()
    command, quiet = [words[0], "-displayfd", str(write), *words[1:], "-nolisten", "tcp"], subprocess.DEVNULL
    with subprocess.Popen(command, pass_fds=[write], stdout=quiet, stderr=quiet) as server:
        os.close(write)
        with os.fdopen(read) as stream:
            number = stream.readline().strip()
        try:
            yield f":{number}" if number else ""
        finally:
            server.terminate()


@pytest.fixture(scope="session")
def gl_info() -> ContextInfo:
    """The context that draws; skips where there is none."""
    try:
        return context_info()
    except NoContextError as error:
        pytest.skip(str(error))


def collect(ctx: moderngl.Context) -> int:
    """Free the GL objects that were dropped without being released; how many there were."""
    dropped = [item for item in ctx.objects if hasattr(item, "release")]
    ctx.objects.clear()
    for item in dropped:
        item.release()
    return len(dropped)


@pytest.fixture
def gl(gl_info: ContextInfo) -> Iterator[moderngl.Context]:
    """This thread's GL context; afterwards no error is pending and nothing was left unreleased.

    What lived before a test is no matter of it: searching that for cycles takes longer than to draw.
    """
    ctx = context()
    gc.collect()
    gc.freeze()
    collect(ctx)
    assert ctx.error == "GL_NO_ERROR"
    yield ctx
    assert ctx.error == "GL_NO_ERROR"
    gc.collect()
    assert collect(ctx) == 0


@pytest.fixture(params=["gl", "numpy"])
def renderer(request: pytest.FixtureRequest) -> str:
    """Both renderers, one after the other; skips the first where no context draws."""
    name: str = request.param
    if name == "gl":
        request.getfixturevalue("gl")
    return name
