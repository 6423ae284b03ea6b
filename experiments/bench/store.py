"""Cells timed one after the other; results are stored on disk, one JSON file per cell."""

import json
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

from optolever import __version__
from optolever.files import atomic_file, write_json
from optolever.records import Progress, silent

from .cell import FAILED, Cell, Row, csv_text
from .run import check, run_cells, warm_up


class Store:
    """A folder: cells/KEY.json, results.json and results.csv."""

    def __init__(self, folder: str | Path) -> None:
        self.folder = Path(folder)
        (self.folder / "cells").mkdir(parents=True, exist_ok=True)

    def path(self, cell: Cell) -> Path:
        """Path of the cell's result."""
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


def time_cells(cells: Iterable[Cell], store: Store, progress: Progress = silent) -> Iterator[Row]:
    """Rows with repeated timings, in this process, each saved when it is done."""
    wanted = list(cells)
    check(wanted)
    warm_up(wanted, progress)
    for done, row in enumerate(run_cells(wanted)):
        store.save(row)
        yield row
        progress(f"{row.cell.scene}, {row.cell.sequence}", done + 1, len(wanted))
