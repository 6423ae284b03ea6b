"""The virtual rig for a long time, with its page, a client, a probe and a recording: what grows?"""

import os
import resource
import tempfile
import threading
import time
import urllib.request
from collections import deque
from collections.abc import Iterator
from contextlib import suppress

import numpy as np

from optolever.live import Followed, LiveServer, virtual_rig
from optolever.scene import load, resize


def soaked(minutes: float, size: tuple[int, int], seed: int) -> Iterator[dict[str, float]]:
    """Figures of this process after a minute, half of the time and all of it, at 20 frames a second."""
    prepared, camera = virtual_rig(resize(load("prism48", exact=True), *size), seed=seed, rate=20.0)
    last, start = deque[Followed](maxlen=40), time.monotonic()
    with (
        tempfile.TemporaryDirectory() as folder,
        LiveServer(prepared, camera, record=f"{folder}/film", heard=last.append) as server,
    ):
        server.command("probe")
        threading.Thread(target=_poll, args=(server,), daemon=True).start()
        for until in (1.0, minutes / 2, minutes):
            time.sleep(max(start + 60 * until - time.monotonic(), 0.0))
            yield {
                "minutes": until,
                "readings": server.readings,
                "peak_mb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
                "threads": len(os.listdir("/proc/self/task")),
                "files": len(os.listdir("/proc/self/fd")),
                "delay_ms": 1e3 * float(np.median([one.delay for one in last])),
            }


def _poll(server: LiveServer) -> None:
    """As the page does, until it is gone."""
    with suppress(OSError):
        while True:
            urllib.request.urlopen(f"{server.address}next?after={server.readings}").read()
