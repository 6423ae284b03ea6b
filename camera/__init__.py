"""camera: cameras and what they take: acquisition, synchronisation, recordings, a rig's devices.

| file | holds |
|---|---|
| `acquisition/` | an image for every pattern: clocks, synchronisation, exposure |
| `recording.py` | recordings |
| `rig_devices.py` | `[devices]` of a rig, opened |
| `cameras/` | back-ends of cameras |
"""

from .acquisition import (
    SAFE_WAIT_S,
    Aim,
    Arrivals,
    ClockMap,
    Contrast,
    FlipRecord,
    Stamp,
    Taken,
    Timing,
    acquire,
    aim,
    choose_exposure,
    contrast,
    fit_timing,
    sync_notices,
    synchronise,
)
from .recording import BackgroundRecorder, Logged, Recorder, Recording
from .rig_devices import VIRTUAL, Devices, Opened, devices_of, opened, timing_of, virtual_scene

__all__ = [
    "SAFE_WAIT_S", "VIRTUAL", "Aim", "Arrivals", "BackgroundRecorder", "ClockMap", "Contrast", "Devices",
    "FlipRecord", "Logged", "Opened", "Recorder", "Recording", "Stamp", "Taken", "Timing", "acquire",
    "aim", "choose_exposure", "contrast", "devices_of", "fit_timing", "opened", "sync_notices",
    "synchronise", "timing_of", "virtual_scene",
]  # fmt: skip
