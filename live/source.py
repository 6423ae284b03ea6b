"""Where frames come from: a `projector.Camera` that runs, or anything else with its `next`.

`VirtualFinger` simulates a camera: a finger presses, slides and lifts on a scene's mirror, in cycles.
`Newest` reads a camera on a thread and hands out the newest frame: where a reading takes longer than a frame,
frames are skipped and counted, none is late."""

from __future__ import annotations

import math
import time
from contextlib import suppress
from dataclasses import replace
from queue import Empty, Queue
from threading import Thread
from typing import Protocol, runtime_checkable

import numpy as np

from optolever.arrays import Frame, Pixels
from optolever.decode import Correspondence, decode
from optolever.patterns import Sequence, sequence
from optolever.projector import (
    NOMINAL_SENSOR,
    WHITE_NOISE_SENSOR,
    FrameElectronics,
    Image,
    capture,
    footprints,
    light_of,
)
from optolever.scene import Scene, Surface, dent

from .rest.prepare import prepare
from .rest.prepared import Prepared

__all__ = ["Newest", "Source", "VirtualFinger", "virtual_rig"]

PERIOD = 10.0  # of the fringe, pattern pixels
_RESTS = 8  # frames at rest
_CYCLE = 48  # frames of a press
_DEPTH = 0.35  # of the curvature at which the picture folds, at most


@runtime_checkable
class Source(Protocol):
    """Interface of a running camera."""

    def next(self, timeout_s: float) -> Image | None:
        """The next frame; None: nothing came."""


class VirtualFinger:
    """Frames of a finger on a scene's mirror, by its sensor, at `rate` a second by the clock, or (0) as they
    are asked for. noise: added to the sensor's, 8-bit levels, rms."""

    def __init__(
        self, scene: Scene, fringe: Sequence, noise: float = 0.0, seed: int = 0, rate: float = 0.0
    ) -> None:
        self._scene, self._fringe, self._seed, self._rate = scene, fringe, seed, rate
        self._sensor = scene.sensor or NOMINAL_SENSOR
        self._noise = math.hypot(noise, self._sensor.noise)
        self._lights: dict[int, Pixels] = {}
        self._number, self._due = 0, 0.0

    def next(self, timeout_s: float) -> Image | None:
        """The next frame; None if it comes later than `timeout_s`."""
        due = max(now := time.monotonic(), self._due)
        time.sleep(min(due - now, timeout_s))
        if due - now > timeout_s:
            return None
        self._due = due + 1 / self._rate if self._rate > 0 else 0.0
        number, self._number = self._number, self._number + 1
        phase = number % _CYCLE
        if phase not in self._lights:
            self._lights[phase] = _light(self._scene, self.surface(number), self._fringe)
        return Image(self._exposed(self._lights[phase], number), number, None, due)

    def surface(self, number: int) -> Surface:
        """The mirror in the frame of that number (the `id` of its image)."""
        return _finger(self._scene, number % _CYCLE / _CYCLE)

    def at_rest(self) -> Frame:
        """Frames (N, H, W) of the mirror at rest."""
        light = _light(self._scene, dent("flat", self._scene), self._fringe)
        return np.stack([self._exposed(light, -1 - k) for k in range(_RESTS)])

    def _exposed(self, light: Pixels, number: int) -> Frame:
        sensor, bits = self._sensor, self._sensor.bits
        frame: Frame = np.empty(light.shape, np.uint8 if bits == 8 else np.uint16)
        electronics = FrameElectronics.of_frame(sensor, 1.0, self._noise, bits, self._seed, number % 2**32)
        electronics.expose(light, frame)
        return frame


def virtual_rig(
    scene: Scene, *, cell: int = 2, noise: float = 1.5, seed: int = 0, rate: float = 0.0
) -> tuple[Prepared, VirtualFinger]:
    """A scene captured at rest, prepared, and its camera. noise: 8-bit levels; cell: see prepare."""
    rows, cols = scene.pattern.rows, scene.pattern.cols
    full, fringe = sequence("gray+phase", rows, cols), sequence("crossed", rows, cols, period=PERIOD)
    flat = dent("flat", scene)
    seen = capture(scene, flat, full, renderer="numpy", noise=noise, seed=seed)
    rest_map: Correspondence = decode(seen.frames, full)
    scene = replace(scene, sensor=scene.sensor or WHITE_NOISE_SENSOR)
    camera = VirtualFinger(scene, fringe, noise, seed, rate)
    return prepare(scene, camera.at_rest(), rest_map, fringe, cell=cell, seed=seed), camera


class Newest:
    """A source read on a thread; `next` gives the newest frame that was not given before. A context
    manager."""

    def __init__(self, source: Source) -> None:
        self._source, self.skipped, self.camera = source, 0, getattr(source, "camera", None)
        self._newest: Queue[Image | Exception] = Queue(1)
        self._over = False
        self._thread = Thread(target=self._read, daemon=True)

    def __enter__(self) -> Newest:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._over = True
        self._thread.join(timeout=5.0)

    def next(self, timeout_s: float) -> Image | None:
        """The newest frame; None: nothing came. Errors of the camera come through."""
        try:
            found = self._newest.get(timeout=timeout_s)
        except Empty:
            return None
        if isinstance(found, Exception):
            raise found
        return found

    def _read(self) -> None:
        found: Image | Exception | None = None
        while not (self._over or isinstance(found, Exception)):
            try:
                found = self._source.next(0.2)
            except Exception as error:  # handed to whoever asks for the next frame
                found = error
            if found is not None:
                with suppress(Empty):
                    self._newest.get_nowait()
                    self.skipped += 1
                self._newest.put(found)


def _light(scene: Scene, surface: Surface, fringe: Sequence) -> Pixels:
    rows, cols = scene.camera.rows, scene.camera.cols
    seen = footprints(scene, surface, 0, rows)
    light = light_of(seen, fringe, scene.display, scene.pattern.blur_px)[0]
    return np.asarray(light.reshape(rows, cols), np.float32)


def _finger(scene: Scene, phase: float) -> Surface:
    """Pressed in and lifted over two thirds of the cycle while it slides; then nothing."""
    length, width = scene.mirror.length, scene.mirror.width
    sigma = 0.12 * min(length, width)
    rows, cols = scene.pattern.rows, scene.pattern.cols
    away = float(np.linalg.norm(scene.pattern.point(cols / 2, rows / 2) - (length / 2, width / 2, 0)))
    peak = _DEPTH * sigma**2 / max(length, away) * math.sin(min(phase * 1.5, 1.0) * math.pi) ** 2
    if peak < 1e-6 * width:
        return dent("flat", scene)
    x, y = (0.38 + 0.2 * phase) * length, (0.5 + 0.12 * math.sin(2 * math.pi * phase)) * width
    return dent("gaussian", scene, peak=peak, sigma=sigma, x=x, y=y)
