"""Grids of a bench: what is finished is read from disk, the rest runs here or on a Dask cluster, one thread
per worker.
"""

import importlib
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from typing import Any

from optolever.blocks import ONE_THREAD
from optolever.errors import InputError
from optolever.experiments.bench import Cell, Row, Store, run_cells
from optolever.experiments.bench.cell import grouped
from optolever.experiments.bench.run import check
from optolever.experiments.bench.worker import compile_apart, group_rows
from optolever.processes import safe_path
from optolever.records import Progress, silent

RETRIES = 3  # of a task whose worker died or lost its result


def sweep(
    cells: Iterable[Cell],
    store: Store,
    workers: int = 0,
    scheduler: str | None = None,
    progress: Progress = silent,
) -> Iterator[Row]:
    """Rows of all cells: first those that the store has, then the others as they are finished and saved.

    workers 0: in this process; else so many local processes of one thread each; scheduler: address of a
    running Dask cluster, in place of local workers.

    The numbers do not depend on where they are computed, to the last bit if this process was started with
    blocks.ONE_THREAD in its environment, as every worker is; the timings are of single runs and do.
    InputError for unknown solvers, decoders, or a cluster that cannot be had.
    """
    wanted = list(dict.fromkeys(cells))
    check(wanted)
    finished = 0
    missing: list[Cell] = []
    for cell in wanted:
        row = store.load(cell)
        if row is None:
            missing.append(cell)
        else:
            finished += 1
            yield row
    progress("resumed" if finished else "start", finished, len(wanted))
    if missing and scheduler is None:
        progress("compile", finished, len(wanted))
        compile_apart(missing)
    local = workers == 0 and scheduler is None
    for row in run_cells(missing, timed=False) if local else _on_dask(missing, workers, scheduler):
        store.save(row)
        finished += 1
        yield row
        progress(f"{row.cell.scene}, {row.cell.sequence}", finished, len(wanted))


def _on_dask(cells: list[Cell], workers: int, scheduler: str | None) -> Iterator[Row]:
    """Groups of cells as tasks. A task whose worker dies runs again elsewhere."""
    if not cells:
        return
    with _client(workers, scheduler) as (dask, client):
        if scheduler is not None:
            client.run(compile_apart, cells)
        tasks = [
            client.submit(group_rows, group, pure=False, retries=RETRIES, key=f"cells-{group[0].key}-{place}")
            for place, group in enumerate(grouped(cells))
        ]
        try:
            for _, rows in dask.as_completed(tasks, with_results=True):
                yield from rows
        finally:
            client.cancel(tasks)


@contextmanager
def _client(workers: int, scheduler: str | None) -> Iterator[tuple[Any, Any]]:
    try:
        dask: Any = importlib.import_module("distributed")
    except ImportError as error:
        raise InputError("workers: needs Dask (pip install distributed)") from error
    if scheduler is not None:
        try:
            client = dask.Client(scheduler, timeout="10s")
        except (OSError, ValueError) as error:
            raise InputError(f"scheduler {scheduler!r}: no answer ({error})") from error
        with client:
            yield dask, client
        return
    options = {"threads_per_worker": 1, "processes": True, "dashboard_address": None, "env": ONE_THREAD}
    with safe_path(), dask.LocalCluster(n_workers=workers, **options) as local, dask.Client(local) as client:
        yield dask, client
