"""Writers of heights in other programs' formats: TIFF; meshes (PLY, STL) and points (XYZ) of the camera's
pixels; SDF (ISO 25178-71), Zygo's DAT, X3P (ISO 25178-72, ISO 5436-2: a zip of main.xml, bindata/data.bin,
md5checksum.hex), DFTFringe's WFT, CSV and NPY of a regular grid.
"""

import hashlib
import io
import struct
import zipfile
from collections.abc import Callable, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import tifffile
from numpy.typing import NDArray

from optolever import __version__
from optolever.arrays import Floats, Mask
from optolever.errors import InputError
from optolever.files import atomic_file

__all__ = ["DAT_MAGIC", "DAT_STEPS", "DAT_UNKNOWN", "MESHES", "REGULAR", "WFT_NM", "chosen",
           "write_tiff"]  # fmt: skip


_METRES = 1e-3  # per mm
_DISC = 0.9  # of the circle around the known points, that they fill at least
_DATA = "bindata/data.bin"
_CHECKSUM = "md5checksum.hex"
#: main.xml: x and y go by increments (I), z is absolute (A); D: float64. The schema asks for a date of
#: calibration; none is known: the date of the file.
_DOCUMENT = """<?xml version="1.0" encoding="utf-8"?>
<p:ISO5436_2 xmlns:p="http://www.opengps.eu/2008/ISO5436_2">
  <Record1>
    <Revision>ISO5436 - 2000</Revision>
    <FeatureType>SUR</FeatureType>
    <Axes>
      <CX><AxisType>I</AxisType><DataType>D</DataType><Increment>{step!r}</Increment><Offset>{x0!r}</Offset></CX>
      <CY><AxisType>I</AxisType><DataType>D</DataType><Increment>{step!r}</Increment><Offset>{y0!r}</Offset></CY>
      <CZ><AxisType>A</AxisType><DataType>D</DataType></CZ>
    </Axes>
  </Record1>
  <Record2>
    <Date>{now}</Date>
    <Instrument>
      <Manufacturer>optolever</Manufacturer>
      <Model>deflectometry</Model>
      <Serial>not available</Serial>
      <Version>{version}</Version>
    </Instrument>
    <CalibrationDate>{now}</CalibrationDate>
    <ProbingSystem><Type>NonContacting</Type><Identification>optical lever</Identification></ProbingSystem>
    <Comment>Mirror frame: z = 0 at rest, positive into the medium. CalibrationDate is the file's.</Comment>
  </Record2>
  <Record3>
    <MatrixDimension><SizeX>{cols}</SizeX><SizeY>{rows}</SizeY><SizeZ>1</SizeZ></MatrixDimension>
    <DataLink>
      <PointDataLink>{link}</PointDataLink>
      <MD5ChecksumPointData>{checksum}</MD5ChecksumPointData>
    </DataLink>
  </Record3>
  <Record4><ChecksumFile>{sums}</ChecksumFile></Record4>
</p:ISO5436_2>
"""
#: Fields of a MetroPro header of format 2 that readers go by: place, kind, in the order of `_dat_header`.
#: MetroPro Reference Guide OMP-0347, appendix "MetroPro binary data format". Big-endian.
_DAT_SIZE, DAT_MAGIC, DAT_UNKNOWN = 834, 0x881B0370, 2147483640
DAT_STEPS = {2: 131072, 1: 32768, 0: 4096}  # of a wave, by the code of the resolution
_WAVE = float(np.float32(632.8e-9))  # m, as the header holds it
#: nm, of a wave in a .wft file.
WFT_NM = 550.0
_OBLIQUITY, _FRINGE = 1.0, 0.5  # waves of height per fringe


def chosen(path: str | Path, known: Sequence[str]) -> str:
    """The path's suffix. InputError names the suffixes that are known."""
    suffix = Path(path).suffix.lower()
    if suffix not in known:
        raise InputError(f"{path}: suffix {suffix!r}, must be {' or '.join(known)}")
    return suffix


def write_tiff(path: str | Path, z: Floats, pitch_mm: float | None = None, *_: float) -> None:
    """z (rows, cols) in mm as float32; with a pitch also the resolution in pixels per centimetre."""
    scale: dict[str, Any] = {}
    if pitch_mm is not None:
        scale = {"resolution": (10.0 / pitch_mm, 10.0 / pitch_mm), "resolutionunit": "CENTIMETER"}
    image = io.BytesIO()
    tifffile.imwrite(image, z.astype(np.float32), metadata={"unit": "mm", "axes": "YX"}, **scale)
    _store(path, image.getvalue())


def write_ply(path: str | Path, x: Floats, y: Floats, z: Floats, sigma: Floats, good: Mask) -> None:
    """Vertices x, y, z, sigma (float32, mm) of the good pixels, and the triangles between neighbours."""
    _require_any(path, good)
    names = ("x", "y", "z", "sigma")
    vertices = np.empty(int(good.sum()), dtype=[(name, "<f4") for name in names])
    for name, values in zip(names, (x, y, z, sigma), strict=True):
        vertices[name] = values[good]
    triangles = _triangles(good)
    faces = np.empty(len(triangles), dtype=[("count", "u1"), ("corners", "<i4", (3,))])
    faces["count"], faces["corners"] = 3, triangles
    header = [
        "ply",
        "format binary_little_endian 1.0",
        "comment optolever height map, mm, mirror frame",
        f"element vertex {len(vertices)}",
        *(f"property float {name}" for name in names),
        f"element face {len(faces)}",
        "property list uchar int vertex_indices",
        "end_header",
    ]
    _store(path, ("\n".join(header) + "\n").encode("ascii"), vertices.tobytes(), faces.tobytes())


def write_stl(path: str | Path, x: Floats, y: Floats, z: Floats, _: Floats, good: Mask) -> None:
    """The triangles between neighbouring good pixels as binary STL, mm; normals towards +z."""
    _require_any(path, good)
    points = np.stack([x[good], y[good], z[good]], axis=1)
    corners = points[_triangles(good)]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    down = normals[:, 2] < 0
    corners[down] = corners[down, ::-1]
    normals[down] *= -1
    with np.errstate(invalid="ignore"):
        normals = np.nan_to_num(normals / np.linalg.norm(normals, axis=1, keepdims=True))
    facets = np.zeros(
        len(corners), dtype=[("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")]
    )
    facets["normal"], facets["corners"] = normals, corners
    title = b"optolever height map, mm, mirror frame".ljust(80)
    _store(path, title, struct.pack("<I", len(facets)), facets.tobytes())


def write_xyz(path: str | Path, x: Floats, y: Floats, z: Floats, _: Floats, good: Mask) -> None:
    """A line `x y z` (mm) per good pixel."""
    _require_any(path, good)
    text = io.StringIO()
    np.savetxt(text, np.stack([x[good], y[good], z[good]], axis=1), fmt="%.9g")
    _store(path, text.getvalue().encode("ascii"))


def write_sdf(path: str | Path, z: Floats, pitch_mm: float, *_: float) -> None:
    """z (rows, cols) mm, NaN where unknown, as ASCII SDF (ISO 25178-71), metres, without an origin."""
    known = np.isfinite(z)
    _require_any(path, known)
    now = datetime.now(UTC).strftime("%d%m%Y%H%M")
    fields = {
        "ManufacID": "optolever ",
        "CreateDate": now,
        "ModDate": now,
        "NumPoints": z.shape[1],
        "NumProfiles": z.shape[0],
        "Xscale": float(pitch_mm) * _METRES,
        "Yscale": float(pitch_mm) * _METRES,
        "Zscale": _METRES,
        "Zresolution": -1,
        "Compression": 0,
        "DataType": 7,
        "CheckType": 0,
    }
    lines = ["aISO-1.0", *(f"{name} = {value}" for name, value in fields.items()), "*"]
    for row, there in zip(z, known, strict=True):
        lines.append(" ".join(f"{value:.9g}" if ok else "BAD" for value, ok in zip(row, there, strict=True)))
    _store(path, "\n".join([*lines, "*", "*", ""]).encode("ascii"))


def write_dat(path: str | Path, z: Floats, pitch_mm: float, *_: float) -> None:
    """z (rows, cols) mm, NaN where unknown, as Zygo MetroPro binary data, in the finest steps that hold it.

    InputError where the heights exceed 165 mm, or a side 65535 points.
    """
    known = np.isfinite(z)
    _require_any(path, known)
    if max(z.shape) > 0xFFFF:
        raise InputError(
            f"{path}: {z.shape[0]} x {z.shape[1]} points, at most 65535 a side; name a larger pitch"
        )
    largest = float(np.abs(z[known]).max())
    units = {code: _FRINGE * _WAVE / steps / _METRES for code, steps in DAT_STEPS.items()}  # mm
    code = next((each for each, unit in units.items() if largest / unit < DAT_UNKNOWN), None)
    if code is None:
        most = DAT_UNKNOWN * max(units.values())
        raise InputError(f"{path}: heights up to {largest:.4g} mm, this format holds {most:.4g} mm")
    values = np.full(z.shape, DAT_UNKNOWN, ">i4")
    values[known] = np.round(z[known] / units[code])
    rows, cols = z.shape
    header = bytearray(_DAT_SIZE)
    for place, kind, value in (
        (0, ">I", DAT_MAGIC),
        (4, ">H", 2),
        (6, ">I", _DAT_SIZE),
        (68, ">H", cols),
        (70, ">H", rows),
        (72, ">I", values.nbytes),
        (76, ">I", int(datetime.now(UTC).timestamp())),
        (164, ">f", _FRINGE),
        (168, ">f", _WAVE),
        (176, ">f", _OBLIQUITY),
        (184, ">f", pitch_mm * _METRES),
        (218, ">H", code),
        (234, ">H", cols),
        (236, ">H", rows),
    ):
        struct.pack_into(kind, header, place, value)
    header[80:161] = b"optolever".ljust(81)
    _store(path, bytes(header), values.tobytes())


def write_x3p(path: str | Path, z: Floats, pitch_mm: float, x0_mm: float, y0_mm: float) -> None:
    """z (rows, cols) mm, NaN where unknown, at x = x0 + j pitch, y = y0 + i pitch, as X3P: lengths in metres,
    x runs fastest (little-endian float64). https://sourceforge.net/p/open-gps/mwiki/X3p.
    """
    _require_any(path, np.isfinite(z))
    data = np.ascontiguousarray(z * _METRES, dtype="<f8").tobytes()
    document = _DOCUMENT.format(
        step=float(pitch_mm) * _METRES,
        x0=float(x0_mm) * _METRES,
        y0=float(y0_mm) * _METRES,
        now=datetime.now(UTC).isoformat(timespec="seconds"),
        version=__version__,
        rows=z.shape[0],
        cols=z.shape[1],
        link=_DATA,
        checksum=_md5(data),
        sums=_CHECKSUM,
    ).encode()
    container = io.BytesIO()
    with zipfile.ZipFile(container, "w", compression=zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("main.xml", document)
        archive.writestr(_DATA, data)
        archive.writestr(_CHECKSUM, f"{_md5(document)} *main.xml\n")
    _store(path, container.getvalue())


def write_wft(path: str | Path, z: Floats, pitch_mm: float, *_: float) -> None:
    """z (rows, cols) mm as the wavefront that the surface reflects, twice its height, in waves of 550 nm: a
    text of a value a line, the lowest row first. The outside ellipse is the circle around the known points;
    unknown ones in it are 0. InputError as of _disc.
    """
    row, col, radius = _disc(path, z)
    waves = 2e6 / WFT_NM * np.nan_to_num(z)
    lines = [str(z.shape[1]), str(z.shape[0]), *(f"{value:.9g}" for value in waves[::-1].ravel())]
    lines.append(f"outside ellipse {row:.9g} {col:.9g} {radius:.9g} {radius:.9g}")
    lines += [f"DIAM {2 * radius * pitch_mm:.9g}", "ROC 0", f"Lambda {WFT_NM:g}", ""]
    _store(path, "\n".join(lines).encode("ascii"))


def _disc(path: str | Path, z: Floats) -> tuple[float, float, float]:
    """Middle (row, column) and radius, points, of the circle around the known points. InputError where these
    are no disc: DFTFringe has no other mask."""
    known = np.isfinite(z)
    _require_any(path, known)
    row, col = np.nonzero(known)
    centre = 0.5 * (col.min() + col.max()), 0.5 * (row.min() + row.max())
    radius = float(np.hypot(col - centre[0], row - centre[1]).max())
    if known.sum() < _DISC * np.pi * radius**2:
        raise InputError(
            f"{path}: the known points are no disc, as a .wft file holds it; "
            "`form --aperture circle --out FILE.wft` writes one"
        )
    return *centre, radius


def write_csv(path: str | Path, z: Floats, pitch_mm: float, x0_mm: float, y0_mm: float) -> None:
    """z (rows, cols) mm, a line a row, nan where unknown, behind a line with pitch, x0 and y0."""
    _require_any(path, np.isfinite(z))
    text = io.StringIO()
    text.write(f"# heights in mm; pitch {float(pitch_mm)!r} x0 {float(x0_mm)!r} y0 {float(y0_mm)!r}\n")
    np.savetxt(text, z, fmt="%.17g", delimiter=",")
    _store(path, text.getvalue().encode("ascii"))


def write_npy(path: str | Path, z: Floats, pitch_mm: float, x0_mm: float, y0_mm: float) -> None:
    """x, y, z (3, rows, cols) mm, float64."""
    _require_any(path, np.isfinite(z))
    x, y = np.meshgrid(
        *(start + pitch_mm * np.arange(n) for start, n in zip((x0_mm, y0_mm), z.shape[::-1], strict=True))
    )
    data = io.BytesIO()
    np.save(data, np.stack([x, y, z]))
    _store(path, data.getvalue())


def _store(path: str | Path, *parts: bytes) -> None:
    with atomic_file(path) as temporary:
        temporary.write_bytes(b"".join(parts))


def _require_any(path: str | Path, good: Mask) -> None:
    if not good.any():
        raise InputError(f"{path}: the height map has no good point to write")


def _triangles(good: Mask) -> NDArray[np.int32]:
    """Vertex numbers (N, 3) of the two triangles of every square of four good pixels' halves."""
    number = np.cumsum(good).reshape(good.shape).astype(np.int32) - 1
    a, b, c, d = np.s_[:-1, :-1], np.s_[:-1, 1:], np.s_[1:, 1:], np.s_[1:, :-1]
    halves = []
    for corners in ((a, b, c), (a, c, d)):
        whole = good[corners[0]] & good[corners[1]] & good[corners[2]]
        halves.append(np.stack([number[corner][whole] for corner in corners], axis=1))
    return np.concatenate(halves)


def _md5(data: bytes) -> str:
    return hashlib.md5(data, usedforsecurity=False).hexdigest()


#: Writers of points and meshes, and of regular grids, by suffix.
MESHES: dict[str, Callable[[str | Path, Floats, Floats, Floats, Floats, Mask], None]]
MESHES = {".ply": write_ply, ".stl": write_stl, ".xyz": write_xyz}
REGULAR: dict[str, Callable[[str | Path, Floats, float, float, float], None]] = {
    **dict.fromkeys((".tif", ".tiff"), write_tiff),
    ".x3p": write_x3p,
    ".sdf": write_sdf,
    ".dat": write_dat,
    ".wft": write_wft,
    ".csv": write_csv,
    ".npy": write_npy,
}
