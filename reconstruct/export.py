"""Height maps in other programs' formats: float32 TIFF and binary PLY."""

import io
from pathlib import Path
from typing import Any

import numpy as np
import tifffile
from numpy.typing import NDArray

from optolever.errors import InputError
from optolever.files import atomic_file

from .arrays import Floats, Mask

__all__ = ["write_ply", "write_tiff"]


def write_tiff(path: str | Path, z: Floats, pitch_mm: float | None = None) -> None:
    """z (rows, cols) in mm as float32; with a pitch also the resolution in pixels per centimetre."""
    scale: dict[str, Any] = {}
    if pitch_mm is not None:
        scale = {"resolution": (10.0 / pitch_mm, 10.0 / pitch_mm), "resolutionunit": "CENTIMETER"}
    # in memory first: NumPy's writing into a file does not say why it failed
    image = io.BytesIO()
    tifffile.imwrite(image, z.astype(np.float32), metadata={"unit": "mm", "axes": "YX"}, **scale)
    with atomic_file(path) as temporary:
        temporary.write_bytes(image.getbuffer())


def write_ply(path: str | Path, x: Floats, y: Floats, z: Floats, sigma: Floats, good: Mask) -> None:
    """Vertices x, y, z, sigma (float32, mm) of the good pixels, and the triangles between neighbours."""
    if not good.any():
        raise InputError(f"{path}: the height map has no good pixel to write")
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
    with atomic_file(path) as temporary, temporary.open("wb") as stream:
        stream.write(("\n".join(header) + "\n").encode("ascii"))
        stream.write(vertices.tobytes())
        stream.write(faces.tobytes())


def _triangles(good: Mask) -> NDArray[np.int32]:
    """Vertex numbers (N, 3) of the two triangles of every square of four good pixels' halves."""
    number = np.cumsum(good).reshape(good.shape).astype(np.int32) - 1
    a, b, c, d = (
        (slice(None, -1), slice(None, -1)),
        (slice(None, -1), slice(1, None)),
        (
            slice(1, None),
            slice(1, None),
        ),
        (slice(1, None), slice(None, -1)),
    )
    halves = []
    for corners in ((a, b, c), (a, c, d)):
        whole = good[corners[0]] & good[corners[1]] & good[corners[2]]
        halves.append(np.stack([number[corner][whole] for corner in corners], axis=1))
    return np.concatenate(halves)
