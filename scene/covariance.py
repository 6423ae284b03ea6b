"""How sure a scene's numbers are: the covariance of a calibration, saved next to the scene, and standard
deviations of numbers that were typed from drawings and data sheets."""

from __future__ import annotations

import datetime
import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import numpy as np

from optolever import InputError
from optolever.files import save_arrays
from optolever.schema import load_record

from .fields import Float, Record, freeze, non_negative

__all__ = ["TYPED", "Accuracy", "Covariance"]


@dataclass(frozen=True, eq=False)
class Accuracy(Record, section="accuracy"):
    """Standard deviations of typed numbers; 0: known exactly.

    angle: of every rotation, rad; distance: of every position, mm; scale: of pitches, relative; focal: of the
    focal length, relative, None: as scale; index: of refraction; centre: of the lens's centre, share of the
    image's columns; distortion: k1 of the lens; bow: of the display, mm at its ends; sag: of the mirror at
    rest, mm; glass: thickness of a cover glass over the display's cells, mm; centroid: of a cell's light,
    cells.
    """

    angle: Annotated[float, non_negative, "angle_deg"] = math.radians(1.0)
    distance: Annotated[float, non_negative, "distance_mm"] = 0.5
    scale: Annotated[float, non_negative] = 0.01
    focal: Annotated[float | None, non_negative] = None
    index: Annotated[float, non_negative] = 0.01
    centre: Annotated[float, non_negative] = 0.015
    distortion: Annotated[float, non_negative] = 0.08
    bow: Annotated[float, non_negative, "bow_mm"] = 0.2
    sag: Annotated[float, non_negative, "sag_mm"] = 0.01
    glass: Annotated[float, non_negative, "glass_mm"] = 1.0
    centroid: Annotated[float, non_negative, "centroid_px"] = 0.05
    edge: Annotated[float, non_negative, "edge_mm"] = 0.001


#: Of a rig that was set up by hand.
TYPED = Accuracy()


@dataclass(frozen=True, eq=False)
class Covariance(Record):
    """Covariance of a scene's parameters: names (p,), matrix (p, p) in their units.

    chi: of the adjustment; gauge: in words, the fixed parameters. InputError unless the matrix is symmetric
    and positive definite.
    sources, parts (s, p, p): the independent error sources, in words, and their contributions to the matrix;
    none: not known.
    date: day of the calibration, as 2026-11-28; empty: not known.
    """

    names: tuple[str, ...]
    matrix: Annotated[Float, "p p"]
    chi: float = 1.0
    gauge: str = ""
    sources: tuple[str, ...] = ()
    parts: Annotated[Float, "s p p"] | None = None
    date: str = ""

    def __post_init__(self) -> None:
        matrix = np.array(self.matrix, dtype=np.float64)
        size = len(self.names)
        if matrix.shape != (size, size) or not np.isfinite(matrix).all():
            raise InputError(f"covariance: has shape {matrix.shape}, must be ({size}, {size}) and finite")
        if twice := {name for name in self.names if tuple(self.names).count(name) > 1}:
            raise InputError(f"covariance: names {', '.join(sorted(twice))} twice")
        scale = np.sqrt(np.abs(np.diag(matrix)))
        if not (scale > 0).all() or np.abs(matrix - matrix.T).max() > 1e-9 * np.abs(matrix).max():
            raise InputError("covariance: is not symmetric with a positive diagonal")
        least = float(np.linalg.eigvalsh(matrix / np.outer(scale, scale)).min()) if size else 1.0
        if least < -1e-9:
            raise InputError(
                f"covariance: is not positive, its smallest correlation eigenvalue is {least:.3g}"
            )
        matrix.flags.writeable = False
        freeze(self, matrix=matrix, names=tuple(self.names), sources=tuple(self.sources))
        parts = np.zeros((0, size, size)) if self.parts is None else np.array(self.parts, dtype=np.float64)
        if parts.shape != (len(self.sources), size, size) or not np.isfinite(parts).all():
            found = f"{len(self.sources)} sources with parts of shape {parts.shape}"
            raise InputError(f"covariance: has {found}, must be one ({size}, {size}) each and finite")
        if len(parts) and np.abs(parts.sum(axis=0) - matrix).max() > 1e-6 * np.abs(matrix).max():
            raise InputError("covariance: its parts do not add up to the matrix")
        freeze(self, parts=parts if len(parts) else None)
        try:
            if self.date:
                datetime.date.fromisoformat(self.date)
        except (TypeError, ValueError):
            raise InputError(f"covariance: date is {self.date!r}, must be as 2026-11-28") from None

    @property
    def root(self) -> Float:
        """L (r, p), r <= p: matrix = L^T L, rows in falling order of their size, without those at the level
        of rounding."""
        scale = np.sqrt(np.diag(self.matrix))
        shares, vectors = np.linalg.eigh(self.matrix / np.outer(scale, scale))
        some = shares > 1e-14 * shares.max()
        root: Float = (np.sqrt(shares[some]) * vectors[:, some]).T[::-1] * scale
        return root

    def scaled(self, factors: Mapping[str, float]) -> Covariance:
        """In other units: each number named times its factor."""
        by = np.array([factors.get(name, 1.0) for name in self.names])
        parts = None if self.parts is None else self.parts * np.outer(by, by)
        return replace(self, matrix=self.matrix * np.outer(by, by), parts=parts)

    @property
    def shares(self) -> Float | None:
        """(s, r, r): contribution of each source to the covariance of the r independent unit-variance errors,
        the rows of `root`: they sum to the unit matrix. None without parts."""
        if self.parts is None:
            return None
        scale = np.sqrt(np.diag(self.matrix))
        inverse = np.linalg.pinv(self.root / scale)  # (p, r) of scaled numbers
        shares: Float = inverse.T @ (self.parts / np.outer(scale, scale)) @ inverse
        return shares

    def save(self, path: str | Path) -> None:
        """Write as .npz."""
        texts = {"names": np.array(self.names), "gauge": np.array(self.gauge)}
        parts = {} if self.parts is None else {"sources": np.array(self.sources), "parts": self.parts}
        save_arrays(path, {**texts, "matrix": self.matrix, "chi": self.chi, **parts})

    @classmethod
    def load(cls, path: str | Path) -> Covariance:
        """Read a file of `save`; InputError names the file and its fault."""
        return load_record(cls, path)
