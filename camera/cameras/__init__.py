"""cameras: one small protocol (`projector.Camera`), one file a back-end, each imported when it is named.

| file | holds |
|---|---|
| `addresses.py` | `find_cameras`, `open_camera`: names become cameras, never numbers |
| `v4l2.py`, `ioctl.py` | Linux cameras by ioctl and mmap; its structures |
| `aravis.py`, `aravis_library.py` | GigE Vision and USB3 Vision by Aravis 0.8 (ctypes); its prototypes |
| `webcam.py`, `pixel_formats.py` | what webcams have in common; packed pixels |
| `pylon.py` | Basler's cameras by pypylon |
| `opencv.py` | streams of network cameras, and films |
| `stand_ins.py` | the images of a capture, or a recording, as a camera with its display |
"""

from .addresses import find_cameras, open_camera
from .stand_ins import Replay, StillCamera

__all__ = ["Replay", "StillCamera", "find_cameras", "open_camera"]
