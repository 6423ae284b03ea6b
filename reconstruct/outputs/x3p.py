"""X3P, the surface format of ISO 25178-72 (ISO 5436-2): a zip of main.xml, bindata/data.bin, md5checksum.hex.

Lengths are metres, x runs fastest in data.bin (little-endian float64), NaN is a point that was not measured.
"""

import hashlib
import zipfile
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from optolever import __version__
from optolever.errors import InputError
from optolever.files import atomic_file

from ..arrays import Floats

__all__ = ["write_x3p"]

_DATA = "bindata/data.bin"
_CHECKSUM = "md5checksum.hex"
_METRES = 1e-3  # per mm
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


def write_x3p(path: str | Path, z: Floats, pitch_mm: float, x0_mm: float, y0_mm: float) -> None:
    """z (rows, cols) mm, NaN where unknown, at x = x0 + j pitch, y = y0 + i pitch. InputError if all is NaN.

    The container is described at https://sourceforge.net/p/open-gps/mwiki/X3p.
    """
    if not np.isfinite(z).any():
        raise InputError(f"{path}: the height map has no good point to write")
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
    with (
        atomic_file(path) as temporary,
        zipfile.ZipFile(temporary, "w", compression=zipfile.ZIP_DEFLATED) as archive,
    ):
        archive.writestr("main.xml", document)
        archive.writestr(_DATA, data)
        archive.writestr(_CHECKSUM, f"{_md5(document)} *main.xml\n")


def _md5(data: bytes) -> str:
    return hashlib.md5(data, usedforsecurity=False).hexdigest()
