"""Results on disk: one JSON file per cell, whole or absent, so that an interrupted grid goes on where it
stopped.
"""

import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from optolever import __version__
from optolever.files import atomic_file, write_json

from .cell import Cell
from .row import FAILED, Row, csv_text

__all__ = ["Store"]


class Store:
    """A folder: cells/KEY.json, results.json and results.csv."""

    def __init__(self, folder: str | Path) -> None:
        self.folder = Path(folder)
        (self.folder / "cells").mkdir(parents=True, exist_ok=True)

    def path(self, cell: Cell) -> Path:
        """Where the cell's result lies."""
        return self.folder / "cells" / f"{cell.key}.json"

    def load(self, cell: Cell) -> Row | None:
        """The cell's row; None if it is absent, failed, unreadable, or of another version of this package."""
        try:
            record = json.loads(self.path(cell).read_text(encoding="utf-8"))
            row = Row.from_dict(record["row"])
        except (OSError, ValueError, KeyError, TypeError):
            return None
        stands = record.get("version") == __version__ and row.cell == cell and row.status != FAILED
        return row if stands else None

    def save(self, row: Row) -> None:
        """Write a cell's row."""
        record = {"version": __version__, "row": row.to_dict()}
        write_json(self.path(row.cell), record)

    def finish(self, rows: Iterable[Row], settings: dict[str, Any], refresh: float) -> None:
        """Write results.json and results.csv of all rows."""
        listed = list(rows)
        record = {"settings": settings, "rows": [row.flat(refresh) for row in listed]}
        write_json(self.folder / "results.json", record)
        with atomic_file(self.folder / "results.csv") as temporary:
            temporary.write_text(csv_text(listed, refresh), encoding="utf-8")
