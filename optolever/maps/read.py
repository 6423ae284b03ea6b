"""Readers of heights on a regular grid, by suffix. Each ends in an InputError with the file's name where the
file is not what its suffix says.
"""

import io
import logging
import re
import struct
import tokenize
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree

import numpy as np
import tifffile
from numpy.typing import NDArray

from optolever.arrays import Floats
from optolever.errors import InputError, damage_of, require_file

from .write import DAT_MAGIC, DAT_STEPS, DAT_UNKNOWN, WFT_NM

__all__ = ["READABLE", "GridMap", "read_grid"]

_METRES, _SQUARE = 1e3, 1e-6  # mm per m; relative difference of the pitches along x and y
_X3P_TYPES = {"D": "<f8", "F": "<f4", "L": "<i4", "I": "<i2"}
_DATX_UNITS = {"NanoMeters": 1e-6, "MicroMeters": 1e-3, "MilliMeters": 1.0, "Meters": 1e3}
_MOST = 1 << 28  # points
_HIGHEST = 1e9  # mm


class GridMap(NamedTuple):
    """z (rows, cols) mm, NaN where unknown; pitch, and x, y of the first point, mm (0 where a format has
    none)."""

    z: Floats
    pitch: float
    x0: float = 0.0
    y0: float = 0.0


def read_grid(path: str | Path) -> GridMap:
    """The heights in a file, in the format of its suffix, of READABLE. InputError names file and fault."""
    file = Path(path)
    reader = _READERS.get(file.suffix.lower())
    if reader is None:
        raise InputError(f"{file}: suffix {file.suffix!r}, must be {' or '.join(READABLE)}")
    require_file(file)
    try:
        with np.errstate(all="ignore"):
            found = reader(file)
    except InputError as error:
        raise InputError(f"{file}: {error}") from error
    except _FAULTS as error:
        kind = file.suffix.lower()[1:].upper()
        raise InputError(f"{file}: not a readable {kind} file ({damage_of(error)})") from error
    if found.z.ndim != 2 or not found.z.size or not 0 < found.pitch < np.inf:
        size = f"{found.z.shape} points at a pitch of {found.pitch:g} mm"
        raise InputError(f"{file}: {size}, must be 2-D, above 0")
    largest = max(float(np.nanmax(np.abs(found.z), initial=0.0)), *map(abs, found[1:]))
    if not largest <= _HIGHEST:
        raise InputError(f"{file}: heights or places of {largest:g} mm, must be at most {_HIGHEST:g}")
    return found


# of a damaged file tifffile also logs; its error says it in one line
logging.getLogger("tifffile").addHandler(logging.NullHandler())
_FAULTS = (
    *(OSError, ValueError, KeyError, IndexError, TypeError, AttributeError, EOFError, OverflowError),
    *(struct.error, zipfile.BadZipFile, ElementTree.ParseError, tifffile.TiffFileError, NotImplementedError),
    *(RuntimeError, MemoryError, ZeroDivisionError, SyntaxError, tokenize.TokenError, zlib.error),
)


def _pitch(along_x: float, along_y: float) -> float:
    """One pitch, mm."""
    if not abs(along_x - along_y) <= _SQUARE * abs(along_x):
        raise InputError(f"points {along_x:g} x {along_y:g} mm apart, must be square; resample it")
    return float(along_x)


def _reshaped(values: NDArray[np.generic], rows: int, cols: int) -> Floats:
    if not 0 < rows * cols <= _MOST or values.size < rows * cols:
        raise InputError(f"{values.size} points, its header says {rows} x {cols}; export it again")
    return np.asarray(values[: rows * cols].reshape(rows, cols), np.float64)


def _tiff(file: Path) -> GridMap:
    with tifffile.TiffFile(file) as tiff:
        page = tiff.pages.first
        heights = page.asarray()
        usual = "mm" if heights.dtype.kind == "f" else "unknown"
        if (unit := (tiff.shaped_metadata or ({},))[0].get("unit", usual)) != "mm":
            raise InputError(f"heights are {heights.dtype}, their unit {unit}; scale them to floats in mm")
        z = np.asarray(heights, np.float64)
        per_cm = page.get_resolution(unit="CENTIMETER")
        scaled = "ResolutionUnit" in page.tags and page.tags["ResolutionUnit"].value != 1
    if z.ndim != 2 or not scaled or per_cm[0] != per_cm[1] or not per_cm[0] > 0:
        raise InputError(
            f"{z.ndim}-D, {per_cm} points per cm, must be 2-D with a scale that is the same along x "
            "and y (as export --pitch writes it)"
        )
    return GridMap(z, 10.0 / per_cm[0])


def _x3p(file: Path) -> GridMap:
    with zipfile.ZipFile(file) as archive:
        root = ElementTree.fromstring(archive.read("main.xml"))

        def text(path: str, default: str = "") -> str:
            return (root.findtext(path) or default).strip()

        kinds = [text(f"Record1/Axes/C{axis}/AxisType") for axis in "XYZ"]
        if kinds != ["I", "I", "A"]:
            raise InputError(f"axes of types {kinds}, must be ['I', 'I', 'A']: a regular grid")
        step = [float(text(f"Record1/Axes/C{axis}/Increment")) * _METRES for axis in "XY"]
        start = [float(text(f"Record1/Axes/C{axis}/Offset", "0")) * _METRES for axis in "XY"]
        cols, rows = (int(text(f"Record3/MatrixDimension/Size{axis}")) for axis in "XY")
        data = archive.read(text("Record3/DataLink/PointDataLink"))
        mask = text("Record3/DataLink/ValidPointsLink")
        valid = np.frombuffer(archive.read(mask), np.uint8) if mask else None
    kind = text("Record1/Axes/CZ/DataType")
    z = np.frombuffer(data, _X3P_TYPES[kind]).astype(np.float64)
    if kind in "LI":
        increment, offset = (float(text(f"Record1/Axes/CZ/{name}", default)) for name, default in
                             (("Increment", "1"), ("Offset", "0")))  # fmt: skip
        z = z * increment + offset
    z = _reshaped(z * _METRES, rows, cols)
    if valid is not None:  # a bit a point, the lowest first
        z[_reshaped(np.unpackbits(valid, bitorder="little"), rows, cols) == 0] = np.nan
    return GridMap(z, _pitch(*step), *start)


def _sdf(file: Path) -> GridMap:
    head, _, body = file.read_text("ascii").partition("*")
    fields = dict(re.findall(r"^\s*(\w+)\s*=\s*(\S+)", head, re.MULTILINE))
    rows, cols = int(fields["NumProfiles"]), int(fields["NumPoints"])
    words = body.partition("*")[0].split()
    z = (
        np.array([np.nan if word == "BAD" else float(word) for word in words])
        * float(fields["Zscale"])
        * _METRES
    )
    step = [float(fields[f"{axis}scale"]) * _METRES for axis in "XY"]
    return GridMap(_reshaped(z, rows, cols), _pitch(*step))


def _dat(file: Path) -> GridMap:
    data = file.read_bytes()
    magic, _, size = struct.unpack_from(">IHI", data)
    if magic not in (DAT_MAGIC, DAT_MAGIC - 1, DAT_MAGIC + 1):
        raise InputError(f"begins with {magic:#x}, a MetroPro file with {DAT_MAGIC:#x}")
    cols, rows, length = struct.unpack_from(">HHI", data, 68)
    (light,) = struct.unpack_from(">I", data, 60)
    fringe, wave, _, oblique = struct.unpack_from(">4f", data, 164)
    (step,), (code,) = struct.unpack_from(">f", data, 184), struct.unpack_from(">H", data, 218)
    values = np.frombuffer(data[size + light : size + light + length], ">i4").astype(np.float64)
    unit = fringe * wave * oblique / DAT_STEPS[code] * _METRES
    z = _reshaped(np.where(values >= DAT_UNKNOWN, np.nan, values * unit), rows, cols)
    return GridMap(z, step * _METRES)


def _datx(file: Path) -> GridMap:
    try:
        import h5py
    except ImportError as error:
        raise InputError("needs h5py; pip install 'optolever[sofast]'") from error
    with h5py.File(file, "r") as tree:
        (surface,) = list(tree["Data"]["Surface"].values())[:1]
        about, z = surface.attrs, np.asarray(surface[()], np.float64)
        if "No Data" in about:
            z[z >= float(np.ravel(about["No Data"])[0])] = np.nan
        unit = np.ravel(about["Unit"])[0]
        unit = unit.decode() if isinstance(unit, bytes) else str(unit)
        if unit == "Fringes":
            names = "Interferometric Scale Factor", "Obliquity Factor", "Wavelength"
            z *= float(np.prod([float(np.ravel(about[name])[0]) for name in names])) * _METRES
        else:
            z *= _DATX_UNITS[unit]
        steps = [float(np.ravel(about[f"{axis} Converter"])[0][-1][1]) * _METRES for axis in "XY"]
    return GridMap(z, _pitch(*steps))


def _wft(file: Path) -> GridMap:
    words = file.read_text("ascii").split()
    cols, rows = int(words[0]), int(words[1])
    values = np.array([float(word) for word in words[2 : 2 + rows * cols]])
    about = " ".join(words[2 + rows * cols :])
    ellipse = re.search(r"outside ellipse (\S+) (\S+) (\S+) (\S+)", about)
    if ellipse is None:
        raise InputError("names no outside ellipse, whose radius in pixels gives the pitch")
    centre, radius = ([float(ellipse[k]) for k in part] for part in ((1, 2), (3, 4)))
    found = {name: re.search(rf"{name} (\S+)", about) for name in ("DIAM", "Lambda")}
    diameter, nm = (float(one[1]) if one else 0.0 for one in found.values())
    waves = _reshaped(values, rows, cols)[::-1]  # the file begins with the lowest row
    row, col = np.mgrid[:rows, :cols]
    outside = ((col - centre[0]) / radius[0]) ** 2 + ((row - centre[1]) / radius[1]) ** 2 > 1 + 1e-9
    z = np.where(outside, np.nan, 0.5 * (nm or WFT_NM) * 1e-6 * waves)
    return GridMap(z, diameter / (2 * radius[0]))


def _csv(file: Path) -> GridMap:
    text = file.read_text("utf-8")
    head = text.partition("\n")[0] if text.startswith("#") else ""
    about = dict(re.findall(r"(pitch|x0|y0|heights in) ([^\s;]+)", head))
    if (unit := about.get("heights in", "mm")) != "mm":
        raise InputError(f"heights in {unit}, must be in mm; scale them")
    if "pitch" not in about:
        raise InputError("its first line must be '# pitch MM' (with x0 MM y0 MM, if they are known)")
    z = np.loadtxt(io.StringIO(text), delimiter=",", ndmin=2)
    return GridMap(z, float(about["pitch"]), float(about.get("x0", 0)), float(about.get("y0", 0)))


def _npy(file: Path) -> GridMap:
    arrays = np.asarray(np.load(file, allow_pickle=False), np.float64)
    if arrays.ndim != 3 or len(arrays) != 3 or min(arrays.shape[1:]) < 2:
        raise InputError(f"has shape {arrays.shape}, must be (3, rows, cols): x, y, z in mm")
    x, y, z = arrays
    pitch = _pitch(float(x[0, 1] - x[0, 0]), float(y[1, 0] - y[0, 0]))
    rows, cols = z.shape
    regular = x[0, 0] + pitch * np.arange(cols), y[0, 0] + pitch * np.arange(rows)
    off = max(float(np.abs(x - regular[0]).max()), float(np.abs(y - regular[1][:, None]).max()))
    if not off <= _SQUARE * pitch * max(z.shape):
        raise InputError("its x, y are no regular grid, x along columns and y along rows")
    return GridMap(z, pitch, float(x[0, 0]), float(y[0, 0]))


_READERS: dict[str, Callable[[Path], GridMap]] = {
    **dict.fromkeys((".tif", ".tiff"), _tiff),
    ".x3p": _x3p,
    ".sdf": _sdf,
    ".dat": _dat,
    ".datx": _datx,
    ".wft": _wft,
    ".csv": _csv,
    ".npy": _npy,
}
#: Suffixes of the formats that are read.
READABLE = tuple(_READERS)
