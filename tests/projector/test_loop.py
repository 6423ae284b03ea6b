"""Window, frame buffer, crystal, optics, GigE Vision, synchronisation, decoder, height: one chain."""

import json
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from .test_cameras import aravis_or_skip

SIZE, FRAMES = "120x160", 250


@pytest.fixture(
    scope="module", params=[{}, {"queue": 3, "lose": 0.002, "gap_every": 7}], ids=["clean", "faults"]
)
def seen(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """What loop.py says, of a clean camera, and of one with a queue of old images, lost packets and gaps."""
    aravis_or_skip()
    if shutil.which("Xvfb") is None:
        pytest.skip("Xvfb is absent (Debian: apt-get install xvfb)")
    folder = tmp_path_factory.mktemp("loop")
    script = Path(__file__).with_name("loop.py")
    server = f"Xvfb :7 -screen 0 1280x1024x24 -fbdir {folder} -nolisten tcp >/dev/null 2>&1 & XVFB=$!"
    faults = json.dumps(request.param)
    run = f"DISPLAY=:7 {sys.executable} {script} {folder} {SIZE} {FRAMES} '{faults}'; CODE=$?"
    wait = f"until [ -e {folder}/Xvfb_screen0 ]; do sleep 0.1; done; sleep 1"
    command = f"ip link set lo up; {server}; {wait}; {run}; kill $XVFB; exit $CODE"
    done = subprocess.run(
        ["unshare", "-n", "sh", "-c", command], capture_output=True, text=True, check=False, timeout=400
    )
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-4000:]
    found: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
    print(json.dumps(found))  # times are told, not asserted
    return found


@pytest.mark.slow
def test_no_frame_is_of_the_wrong_pattern(seen: dict[str, Any]) -> None:
    assert (seen["frames"], seen["wrong"]) == (FRAMES, 0), seen


@pytest.mark.slow
def test_places_and_heights_are_those_of_the_virtual_sensor(seen: dict[str, Any]) -> None:
    """u within 5 %, height within 10 %, over all rounds of the sequence."""
    assert seen["loop"]["u_rms"] == pytest.approx(seen["own"]["u_rms"], rel=0.05)
    assert seen["loop"]["height_rms"] == pytest.approx(seen["own"]["height_rms"], rel=0.10)
