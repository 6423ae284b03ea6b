"""cameras: one small protocol (`projector.Camera`), one file a back-end, each imported when it is named.

| file | holds |
|---|---|
| `addresses.py` | `find_cameras`, `open_camera`: names become cameras, never numbers |
| `v4l2.py`, `ioctl.py` | Linux cameras by ioctl and mmap; its structures |
| `aravis.py`, `aravis_library.py` | GigE Vision and USB3 Vision by Aravis 0.8 (ctypes); its prototypes |
| `pylon.py` | Basler's cameras by pypylon |
| `opencv.py` | whatever cv2.VideoCapture opens by a path or URL |
| `still.py`, `folder.py`, `virtual.py` | cameras that are not there, with the display that they look at |
| `replay.py` | a recording as a camera, its display and its clock |
"""

from .addresses import find_cameras, open_camera
from .folder import FolderCamera
from .replay import Replay
from .virtual import VirtualCamera

__all__ = ["FolderCamera", "Replay", "VirtualCamera", "find_cameras", "open_camera"]
