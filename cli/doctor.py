"""`optolever doctor`: available and missing components of this machine, and the cost of their absence;
cameras and monitors, each with its address.

$ optolever doctor
Found
  optolever                       0.1.0
  python                          3.11.7, Linux-6.18.44-x86_64-with-glibc2.36
  cores                           2
  ...
Missing
  nothing
Cameras
camera                                      model         serial  formats    note
v4l2:/dev/v4l/by-id/usb-Maker_Cam_123-...   Cam: Cam      123     GREY YUYV
gige:192.168.0.12                           acA1920-40gm  22781
Monitors
  0  DELL U2412M:YMYH1234 (1200 x 1920, 60 Hz, 324 x 518 mm, 8 bits)
"""

import importlib.metadata
import importlib.util
import platform
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path

import optolever as ol
from optolever import InputError
from optolever.blocks import threads

from .arguments import program
from .options import Json
from .printing import grid, print_notices, table, write_json

CORE = ("moderngl", "numpy", "opencv-contrib-python-headless", "scipy", "numba", "glfw", "matplotlib")
EXTRAS = {"h5py": "pip install 'optolever[sofast]'; without it SOFAST's HDF5 files cannot be read"}
LIBRARIES = {"aravis-0.8": "apt-get install libaravis-0.8-0; without it no GigE or USB3 Vision camera"}
NONE = {
    "OpenGL": "on Debian: apt-get install libegl1 libgl1 libgl1-mesa-dri; "
    "without it the NumPy renderer draws, correct and slower",
    "numba cache": "set NUMBA_CACHE_DIR to a folder that can be written; "
    "without it the first decode of every process takes seconds longer",
}


@program("doctor", __doc__)
def command(json_path: Json = None) -> None:
    """Say what OpenGL, cameras, monitors, extras there are.

    Cameras and monitors with the words that choose them: a camera's address or serial:NUMBER, a monitor's
    model and serial (or its output), never a number that changes when something is plugged in. Besides:
    camera=folder:DIR, replay:DIR, virtual; display=window.
    """
    from optolever.camera.cameras import find_cameras

    found = {
        "optolever": _version("optolever") or "not installed",
        "python": f"{platform.python_version()}, {platform.platform(terse=True)}",
        "cores": str(threads()),
        **{name: _version(name) or "missing" for name in CORE},
        "OpenGL": _guarded(lambda: str(ol.projector.context_info())),
        "numba cache": _guarded(_cache),
    }
    missing = _missing(found)
    cameras, silent = find_cameras()
    try:
        shown = ol.projector.monitors()
    except InputError as error:
        shown, silent = [], silent | {"monitors": str(error)}
    monitors = [asdict(one) | {"display": one.address, "faults": one.faults()} for one in shown]
    devices = {"cameras": [asdict(one) for one in cameras], "not_looked_for": silent, "monitors": monitors}
    write_json(json_path, {"found": found, "missing": missing, **devices})
    table("Found", found)
    table("Missing", missing or {"nothing": ""})
    rows = [[one.address, one.model, one.serial, " ".join(one.formats[:4]), one.note] for one in cameras]
    grid("Cameras", ("camera", "model", "serial", "formats", "note"), rows or [["none"]])
    print_notices(silent.values())
    print_monitors(shown)


def _version(name: str) -> str | None:
    try:
        return importlib.metadata.version(name)
    except importlib.metadata.PackageNotFoundError:
        return None


def _guarded(probe: Callable[[], str]) -> str:
    """Result of a probe; an exception is a result as well, never a crash of the doctor."""
    try:
        return probe()
    except Exception as error:
        return f"none: {' '.join(str(error).split()) or type(error).__name__}"


def print_monitors(found: "list[ol.projector.Monitor]") -> None:
    """Number and name of each, and notices about settings that spoil patterns."""
    table("Monitors", {str(one.index): str(one) for one in found} or {"none": ""})
    print_notices(fault for one in found for fault in one.faults())


def _cache() -> str:
    """Folder of compiled kernels; the first decode of a capture compiles them."""
    from optolever.kernels import cache_folder

    decode = importlib.util.find_spec("optolever.decode")  # loaded it costs half a second
    assert decode is not None
    place = cache_folder(Path(decode.origin or "").parent)
    if place is None:
        return "none: every process compiles for itself"
    return f"{place} ({len(list(place.rglob('*.nbi')))} kernels of decode)"


def _missing(found: dict[str, str]) -> dict[str, str]:
    from ctypes.util import find_library

    missing = {name: f"pip install {name}" for name in CORE if found[name] == "missing"}
    missing |= {name: cure for name, cure in NONE.items() if found[name].startswith("none")}
    missing |= {name: cost for name, cost in EXTRAS.items() if _version(name) is None}
    return missing | {name: cost for name, cost in LIBRARIES.items() if find_library(name) is None}
