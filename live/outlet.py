"""Readings for other programs as they come: contacts as lines of CSV, whole maps by a Unix socket.

A message of the socket is a line of JSON (the figures; rows, cols and bytes of the map; x_mm, y_mm: of its
first and last column and row) and the heights, mm, as float32, little endian, NaN where there is none. A slow
reader gets the newest message, not all."""

import csv
import json
import socket
import threading
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np

from optolever.errors import InputError, reason_of

from .follow import Followed, plain

__all__ = ["ContactTable", "ReadingSocket"]

_COLUMNS = {
    "x_mm": "x",
    "y_mm": "y",
    "position_sigma_mm": "position_sigma",
    "depth_mm": "depth",
    "depth_sigma_mm": "depth_sigma",
    "area_mm2": "area",
    "area_sigma_mm2": "area_sigma",
    "volume_mm3": "volume",
    "volume_sigma_mm3": "volume_sigma",
    "cut": "cut",
    "hole": "hole",
}
_FORCES = {"force_n": "newton", "force_sigma_n": "sigma", "pressure_n_mm2": "peak"}


class _Outlet:
    """A context manager that closes."""

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """End."""


class ContactTable(_Outlet):
    """A CSV with a row for every contact of a reading, one without a contact where there is none. What is
    killed leaves the rows so far. InputError where the file cannot be written."""

    def __init__(self, path: str | Path) -> None:
        try:
            self._file = Path(path).open("w", newline="", encoding="utf-8")  # noqa: SIM115
        except OSError as error:
            raise InputError(f"{path}: {reason_of(error)}") from error
        self._rows = csv.writer(self._file)
        self._rows.writerow(("time_s", "frame", "trusted", "contact", *_COLUMNS, *_FORCES))

    def write(self, followed: Followed) -> None:
        """The contacts of a reading."""
        reading = followed.reading
        head = f"{reading.time:.6f}", followed.image.id, int(reading.trusted)
        forces = {force.identity: force for force in reading.forces}
        for touch in reading.touches:
            force = forces.get(touch.identity)
            by_name = [getattr(touch, name) for name in _COLUMNS.values()]
            by_name += [None if force is None else getattr(force, name) for name in _FORCES.values()]
            self._rows.writerow((*head, touch.identity, *map(_cell, by_name)))
        if not reading.touches:
            self._rows.writerow((*head, "", *[""] * (len(_COLUMNS) + len(_FORCES))))
        self._file.flush()

    def close(self) -> None:
        """Close the file; all rows are in it already."""
        self._file.close()


def _cell(value: Any) -> Any:
    return "" if value is None else int(value) if isinstance(value, bool) else f"{value:.6g}"


class ReadingSocket(_Outlet):
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
        self._server.listen()
        threading.Thread(target=self._accept, daemon=True).start()

    def write(self, followed: Followed) -> None:
        """The message of a reading, to all who are connected."""
        if not self._clients:
            return
        reading = followed.reading
        z = np.where(reading.good, reading.z, np.nan).astype("<f4")
        row, col = (size // 2 for size in z.shape)
        ends = {"x_mm": reading.x[row, :: z.shape[1] - 1], "y_mm": reading.y[:: z.shape[0] - 1, col]}
        numbers = followed.to_dict() | {name: [float(v) for v in end] for name, end in ends.items()}
        numbers |= {"rows": z.shape[0], "cols": z.shape[1], "bytes": z.nbytes}
        message = json.dumps(plain(numbers)).encode() + b"\n" + z.tobytes()
        self._clients = [client for client in self._clients if client.offer(message)]

    def _accept(self) -> None:
        with suppress(OSError):  # it was closed
            while True:
                self._clients = [*self._clients, _Client(self._server.accept()[0])]

    def close(self) -> None:
        """Disconnect all."""
        with suppress(OSError):
            self._server.shutdown(socket.SHUT_RDWR)
        self._server.close()
        for client in self._clients:
            client.end()
        self._path.unlink(missing_ok=True)


class _Client:
    """Sends the newest message on a thread."""

    def __init__(self, connection: socket.socket) -> None:
        self._connection, self._ready = connection, threading.Condition()
        self._message, self._over = b"", False
        threading.Thread(target=self._send, daemon=True).start()

    def offer(self, message: bytes) -> bool:
        """In place of one that waits; whether somebody reads."""
        with self._ready:
            self._message = message
            self._ready.notify()
        return not self._over

    def end(self) -> None:
        """Once what waits is sent."""
        with self._ready:
            self._over = True
            self._ready.notify()

    def _send(self) -> None:
        with self._connection, suppress(OSError):
            while True:
                with self._ready:
                    self._ready.wait_for(lambda: self._message or self._over)
                    message, self._message = self._message, b""
                if not message:
                    break
                self._connection.sendall(message)
        self._over = True


def _answers(path: Path) -> bool:
    with socket.socket(socket.AF_UNIX) as one:
        return one.connect_ex(str(path)) == 0
