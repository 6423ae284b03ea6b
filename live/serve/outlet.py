"""Readings for other programs as they come: contacts as lines of CSV, whole maps by a Unix socket.

A message of the socket is a line of JSON (the figures; rows, cols and bytes of the map; x_mm, y_mm: of its
first and last column and row) and the heights, mm, as float32, little endian, NaN where there is none. A slow
reader gets the newest message, not all."""

import csv
import json
import socket
from contextlib import AbstractContextManager, suppress
from pathlib import Path
from queue import Empty, Full, Queue
from threading import Thread
from typing import Any

import numpy as np

from optolever.errors import InputError, reason_of
from optolever.files import growing_file, plain

from ..follow import Followed

__all__ = ["ContactTable", "ReadingSocket"]

_COLUMNS = {
    f"{name}{unit}": name
    for unit, names in {
        "_mm": ("x", "y", "position_sigma", "depth", "depth_sigma"),
        "_mm2": ("area", "area_sigma"),
        "_mm3": ("volume", "volume_sigma"),
        "": ("cut", "hole", "depth_at_least", "force_at_least"),
    }.items()
    for name in names
}
_FORCES = {"force_n": "newton", "force_sigma_n": "sigma", "pressure_n_mm2": "peak"}
_LAST_S = 1.0  # for a reader to take the last message


class ContactTable(AbstractContextManager["ContactTable"]):
    """A CSV with a row for every contact of a reading, one without a contact where there is none. What is
    killed leaves the rows so far. InputError where the file cannot be written."""

    def __init__(self, path: str | Path) -> None:
        self._file = growing_file(path)
        self._rows = csv.writer(self._file, lineterminator="\n")
        self._rows.writerow(("time_s", "wall_s", "frame", "trusted", "contact", *_COLUMNS, *_FORCES))

    def write(self, followed: Followed) -> None:
        """The contacts of a reading."""
        reading = followed.reading
        wall = "" if followed.wall is None else f"{followed.wall:.6f}"
        head = f"{reading.time:.6f}", wall, followed.image.id, int(reading.trusted)
        forces = {force.identity: force for force in reading.forces}
        for touch in reading.touches:
            values = [getattr(touch, name) for name in _COLUMNS.values()]
            values += [getattr(forces.get(touch.identity), name, None) for name in _FORCES.values()]
            self._rows.writerow((*head, touch.identity, *map(_cell, values)))
        if not reading.touches:
            self._rows.writerow((*head, "", *[""] * (len(_COLUMNS) + len(_FORCES))))
        self._file.flush()

    def __exit__(self, *_: object) -> None:
        self._file.close()


def _cell(value: Any) -> Any:
    return "" if value is None else int(value) if isinstance(value, bool) else f"{value:.6g}"


class ReadingSocket(AbstractContextManager["ReadingSocket"]):
    """Serves a Unix socket on threads, for programs of this user. InputError where the path is taken."""

    def __init__(self, path: str | Path) -> None:
        self._path, self._clients = Path(path), list[_Client]()
        if self._path.is_socket() and not _answers(self._path):
            self._path.unlink()  # of a program that was killed
        self._server = socket.socket(socket.AF_UNIX)
        try:
            self._server.bind(str(path))
        except OSError as error:
            self._server.close()
            raise InputError(f"{path}: no socket can be made there ({reason_of(error)})") from error
        self._path.chmod(0o600)
        self._made = self._path.stat().st_ino
        self._server.listen()
        Thread(target=self._accept, daemon=True).start()

    def write(self, followed: Followed) -> None:
        """The message of a reading, to all who are connected."""
        if not self._clients:
            return
        reading = followed.reading
        z = np.where(reading.good, reading.z, np.nan).astype("<f4")
        row, col = (size // 2 for size in z.shape)
        ends = {"x_mm": reading.x[row, :: z.shape[1] - 1], "y_mm": reading.y[:: z.shape[0] - 1, col]}
        numbers = followed.to_dict() | {name: end.tolist() for name, end in ends.items()}
        numbers |= {"rows": z.shape[0], "cols": z.shape[1], "bytes": z.nbytes}
        message = json.dumps(plain(numbers)).encode() + b"\n" + z.tobytes()
        self._clients = [client for client in self._clients if client.offer(message)]

    def _accept(self) -> None:
        with suppress(OSError):  # it was closed
            while True:
                self._clients = [*self._clients, _Client(self._server.accept()[0])]

    def __exit__(self, *_: object) -> None:
        with suppress(OSError):
            self._server.shutdown(socket.SHUT_RDWR)
        self._server.close()
        for client in self._clients:
            client.end()
        if self._path.exists() and self._path.stat().st_ino == self._made:  # no file of that name since
            self._path.unlink()


class _Client:
    """Sends the newest message on a thread."""

    def __init__(self, connection: socket.socket) -> None:
        self._connection, self._next = connection, Queue[bytes](1)
        self._thread = Thread(target=self._send, daemon=True)
        self._thread.start()

    def offer(self, message: bytes) -> bool:
        """In place of one that waits; whether somebody reads."""
        with suppress(Empty):
            self._next.get_nowait()
        self._next.put(message)
        return self._thread.is_alive()

    def end(self) -> None:
        """Once what waits is sent."""
        with suppress(Full):
            self._next.put(b"", timeout=_LAST_S)

    def _send(self) -> None:
        with self._connection, suppress(OSError):
            while message := self._next.get():
                self._connection.sendall(message)


def _answers(path: Path) -> bool:
    with socket.socket(socket.AF_UNIX) as one:
        return one.connect_ex(str(path)) == 0
