"""X3P, the surface format of ISO 25178-72 (ISO 5436-2): a zip of main.xml, bindata/data.bin, md5checksum.hex.

Lengths are metres, x runs fastest in data.bin (little-endian float64), NaN is a point that was not measured.
"""

import hashlib
import zipfile
from datetime import UTC, datetime
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from optolever import __version__
from optolever.errors import InputError
from optolever.files import atomic_file

from .arrays import Floats

__all__ = ["write_x3p"]

_NAMESPACE = "http://www.opengps.eu/2008/ISO5436_2"
_DATA = "bindata/data.bin"
_CHECKSUM = "md5checksum.hex"
_METRES = 1e-3  # per mm


def write_x3p(path: str | Path, z: Floats, pitch_mm: float, x0_mm: float, y0_mm: float) -> None:
    """z (rows, cols) mm, NaN where unknown, at x = x0 + j pitch, y = y0 + i pitch. InputError if all is NaN.

    The container is described at https://sourceforge.net/p/open-gps/mwiki/X3p.
    """
    if not np.isfinite(z).any():
        raise InputError(f"{path}: the height map has no good point to write")
    data = np.ascontiguousarray(z * _METRES, dtype="<f8").tobytes()
    document = _document(z.shape[1], z.shape[0], pitch_mm, (x0_mm, y0_mm), _md5(data))
    with (
        atomic_file(path) as temporary,
        zipfile.ZipFile(temporary, "w", compression=zipfile.ZIP_DEFLATED) as archive,
    ):
        archive.writestr("main.xml", document)
        archive.writestr(_DATA, data)
        archive.writestr(_CHECKSUM, f"{_md5(document)} *main.xml\n")


def _document(cols: int, rows: int, pitch: float, start: tuple[float, float], checksum: str) -> bytes:
    """main.xml, its four records in the schema's order."""
    ElementTree.register_namespace("p", _NAMESPACE)
    root = ElementTree.Element(f"{{{_NAMESPACE}}}ISO5436_2")
    now = datetime.now(UTC).isoformat(timespec="seconds")
    _add(root, {"Record1": _axes(pitch, start), "Record2": _origin(now)})
    _add(
        root,
        {
            "Record3": {
                "MatrixDimension": {"SizeX": cols, "SizeY": rows, "SizeZ": 1},
                "DataLink": {"PointDataLink": _DATA, "MD5ChecksumPointData": checksum},
            },
            "Record4": {"ChecksumFile": _CHECKSUM},
        },
    )
    document: bytes = ElementTree.tostring(root, encoding="utf-8", xml_declaration=True)
    return document


def _axes(pitch: float, start: tuple[float, float]) -> dict[str, object]:
    """Record1: x and y go by increments (I), z is absolute (A); D: float64."""
    steps = {
        name: {"AxisType": "I", "DataType": "D", "Increment": pitch * _METRES, "Offset": offset * _METRES}
        for name, offset in zip(("CX", "CY"), start, strict=True)
    }
    axes = {**steps, "CZ": {"AxisType": "A", "DataType": "D"}}
    return {"Revision": "ISO5436 - 2000", "FeatureType": "SUR", "Axes": axes}


def _origin(now: str) -> dict[str, object]:
    """Record2. The schema asks for a date of calibration; nobody told one, so it is the file's own."""
    return {
        "Date": now,
        "Instrument": {
            "Manufacturer": "optolever",
            "Model": "deflectometry",
            "Serial": "not available",
            "Version": __version__,
        },
        "CalibrationDate": now,
        "ProbingSystem": {"Type": "NonContacting", "Identification": "optical lever"},
        "Comment": "Mirror frame: z = 0 at rest, positive into the medium. CalibrationDate is the file's.",
    }


def _add(parent: ElementTree.Element, values: dict[str, object]) -> None:
    for name, value in values.items():
        child = ElementTree.SubElement(parent, name)
        if isinstance(value, dict):
            _add(child, value)
        else:
            child.text = repr(value) if isinstance(value, float) else str(value)


def _md5(data: bytes) -> str:
    return hashlib.md5(data, usedforsecurity=False).hexdigest()
