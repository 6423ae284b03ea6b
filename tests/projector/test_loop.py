"""Window, frame buffer, crystal, optics, GigE Vision, synchronisation, decoder, height: one chain."""

import json
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from .test_cameras import aravis_or_skip

SIZE, FRAMES = "120x160", 250


@pytest.mark.slow
@pytest.mark.parametrize("faults", [{}, {"queue": 3, "lose": 0.002, "gap_every": 7}], ids=["clean", "faults"])
def test_the_chain_gives_what_the_virtual_sensor_gives(faults: dict[str, float], tmp_path: Path) -> None:
    """No frame of the wrong pattern, also of old images, lost packets and gaps; places, heights."""
    aravis_or_skip()
    if shutil.which("Xvfb") is None:
        pytest.skip("Xvfb is absent (Debian: apt-get install xvfb)")
    script = Path(__file__).with_name("loop.py")
    server = f"Xvfb :7 -screen 0 1280x1024x24 -fbdir {tmp_path} -nolisten tcp >/dev/null 2>&1 & XVFB=$!"
    run = f"DISPLAY=:7 {sys.executable} {script} {tmp_path} {SIZE} {FRAMES} '{json.dumps(faults)}'; CODE=$?"
    wait = f"until [ -e {tmp_path}/Xvfb_screen0 ]; do sleep 0.1; done; sleep 1"
    command = f"ip link set lo up; {server}; {wait}; {run}; kill $XVFB; exit $CODE"
    words = ["unshare", "-n", "sh", "-c", command]
    done = subprocess.run(words, capture_output=True, text=True, check=False, timeout=400)
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-4000:]
    seen = json.loads(done.stdout.splitlines()[-1])
    assert (seen["frames"], seen["wrong"]) == (FRAMES, 0), seen
    assert seen["loop"]["u_rms"] == pytest.approx(seen["own"]["u_rms"], rel=0.05)
    assert seen["loop"]["height_rms"] == pytest.approx(seen["own"]["height_rms"], rel=0.10)
