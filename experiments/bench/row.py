"""Row: what a cell gave, as plain numbers; its JSON, the CSV of many, and the order of their columns."""

import csv
import io
import math
from collections.abc import Iterable
from dataclasses import asdict, dataclass, field
from typing import Any

from .cell import Cell

__all__ = ["COLUMNS", "Row", "csv_text"]

DONE, ABSENT, USELESS, FAILED = "done", "not installed", "not applicable", "failed"
TIMINGS = (
    *("render_seconds", "decode_seconds", "floor_seconds", "reconstruct_seconds"),
    *("decode_bytes", "reconstruct_bytes"),
)
METRICS = (
    "height_rms_rel",
    "height_p95_rel",
    "height_max_rel",
    "height_rms_mm",
    "peak_depth_mm",
    "sigma_ratio_height",
    "sigma_ratio_u",
    "sigma_ratio_v",
    "u_rms_px",
    "v_rms_px",
    "flagged_share",
    "silent_share",
    "decode_silent_share",
    "unflagged_invisible",
)
COLUMNS = (
    *("scene", "rows", "cols", "dent", "sequence", "noise", "seed", "solver", "renderer"),
    *("status", "why", "kind", "frames", "display_seconds", *TIMINGS, *METRICS),
)


@dataclass(frozen=True, slots=True)
class Row:
    """One cell's result.

    status: done | not installed | not applicable | failed, and why; kind: own | paper | peer | floor (exact
    correspondence); frames: shown and captured, a rest capture not counted; timings: render_, decode_,
    reconstruct_seconds, floor_seconds (reading the frames and writing as much as a decoder does) and peak
    bytes above the stage's inputs (decode_bytes, reconstruct_bytes), metrics: see `measures.measures`; what
    is not known is absent.
    """

    cell: Cell
    status: str
    why: str = ""
    kind: str = "own"
    frames: int = 0
    timings: dict[str, float] = field(default_factory=dict)
    metrics: dict[str, float] = field(default_factory=dict)

    @property
    def done(self) -> bool:
        """True if there are numbers."""
        return self.status == DONE

    @property
    def compute_seconds(self) -> float:
        """Decode and reconstruct; NaN if one is unknown."""
        return sum(self.timings.get(f"{name}_seconds", math.nan) for name in ("decode", "reconstruct"))

    @property
    def error(self) -> float:
        """Rms height error over the peak depth; NaN without one."""
        return self.metrics.get("height_rms_rel", math.nan)

    def display_seconds(self, refresh: float) -> float:
        """What the display takes to show the frames, one per refresh."""
        return self.frames / refresh

    def numbers(self) -> dict[str, Any]:
        """What must be the same on every run: all but the timings."""
        return {"status": self.status, "frames": self.frames, **self.metrics}

    def to_dict(self) -> dict[str, Any]:
        """Plain JSON types; NaN stays NaN (see `plain`)."""
        return {**asdict(self), "cell": self.cell.to_dict()}

    @classmethod
    def from_dict(cls, record: dict[str, Any]) -> "Row":
        """Inverse of to_dict; None becomes NaN."""
        numbers = {
            name: {key: math.nan if value is None else float(value) for key, value in record[name].items()}
            for name in ("timings", "metrics")
        }
        return cls(**{**record, **numbers, "cell": Cell.from_dict(record["cell"])})

    def flat(self, refresh: float) -> dict[str, Any]:
        """One value per name of COLUMNS; None where nothing is known."""
        cell = self.cell.to_dict()
        rows, cols = cell.pop("size") or (None, None)
        values = {
            **cell,
            "rows": rows,
            "cols": cols,
            "status": self.status,
            "why": self.why,
            "kind": self.kind,
            "frames": self.frames,
            "display_seconds": self.display_seconds(refresh),
            **self.timings,
            **self.metrics,
        }
        return {name: _known(values.get(name)) for name in COLUMNS}


def csv_text(rows: Iterable[Row], refresh: float) -> str:
    """All rows as CSV under a header; empty where nothing is known."""
    stream = io.StringIO()
    writer = csv.DictWriter(stream, COLUMNS, lineterminator="\n")
    writer.writeheader()
    for row in rows:
        writer.writerow({k: "" if v is None else v for k, v in row.flat(refresh).items()})
    return stream.getvalue()


def _known(value: Any) -> Any:
    return None if isinstance(value, float) and not math.isfinite(value) else value
