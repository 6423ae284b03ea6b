"""`optolever doctor`: available and missing components of this machine, and the cost of their absence."""

import importlib.metadata
import importlib.util
import os
import platform
import sys
from collections.abc import Callable
from pathlib import Path

import optolever as ol
from optolever.blocks import threads

from .arguments import program
from .options import Json
from .printing import table, write_json

SAMPLE = """
$ optolever doctor
Found
  optolever                       0.1.0
  python                          3.11.7, Linux-6.18.44-x86_64-with-glibc2.36
  cores                           2
  ...
Missing
  nothing
"""

CORE = ("moderngl", "numpy", "opencv-contrib-python-headless", "scipy", "numba", "glfw", "matplotlib")
EXTRAS = {"h5py": "pip install 'optolever[sofast]'; without it SOFAST's HDF5 files cannot be read"}
LIBRARIES = {"aravis-0.8": "apt-get install libaravis-0.8-0; without it no GigE or USB3 Vision camera"}
NONE = {
    "OpenGL": "on Debian: apt-get install libegl1 libgl1 libgl1-mesa-dri; "
    "without it the NumPy renderer draws, correct and slower",
    "numba cache": "set NUMBA_CACHE_DIR to a folder that can be written; "
    "without it the first decode of every process takes seconds longer",
}


@program("doctor", SAMPLE)
def command(json_path: Json = None) -> None:
    """Say what OpenGL, cameras, monitors, extras there are."""
    found = {
        "optolever": _version("optolever") or "not installed",
        "python": f"{platform.python_version()}, {platform.platform(terse=True)}",
        "cores": str(threads()),
        **{name: _version(name) or "missing" for name in CORE},
        "OpenGL": _guarded(lambda: str(ol.projector.context_info())),
        "monitors": _guarded(_monitors),
        "cameras": _guarded(_cameras),
        "numba cache": _guarded(_cache),
    }
    missing = _missing(found)
    write_json(json_path, {"found": found, "missing": missing})
    table("Found", found)
    table("Missing", missing or {"nothing": ""})


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


def _monitors() -> str:
    if sys.platform == "linux" and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        return "none: no display (DISPLAY and WAYLAND_DISPLAY are unset)"

    found = [str(text) for one in ol.projector.monitors() for text in (one, *one.faults())]
    return "; ".join(found) or "none"


def _cameras() -> str:
    from optolever.camera.cameras import find_cameras

    found, silent = find_cameras()
    told = [f"{one.address} ({one.note or one.model})" for one in found]
    return "; ".join((*told, *silent.values())) or "none"


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
