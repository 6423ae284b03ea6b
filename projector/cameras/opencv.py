"""Whatever OpenCV opens by a path or URL: no serial, no counter, no exposure that can be trusted."""

import sys
import time
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from optolever.errors import InputError

from ..devices import Accepted, CameraLost, Identity, Image, Wanted

__all__ = ["OpenCVCamera", "find", "open_named"]

_MANUAL = (1.0, 0.25)  # of CAP_PROP_AUTO_EXPOSURE: V4L2's number, and older OpenCV's
_GONE_S = 5.0
_EXPOSURE_UNIT_S = 1e-4  # V4L2; elsewhere powers of two


def find() -> list[Identity]:
    """Nothing: OpenCV knows indices only, which change when something is plugged in."""
    return []


def open_named(name: str) -> "OpenCVCamera":
    """By path (/dev/v4l/by-id/...) or URL."""
    return OpenCVCamera(name)


class OpenCVCamera:
    """Read in `next`; the driver's queue is emptied by time, as images carry that of their arrival only."""

    lost = 0  # OpenCV hides the counter

    def __init__(self, name: str) -> None:
        if "://" not in name and not Path(name).exists():
            raise InputError(f"camera: {name}: no such path; optolever camera devices lists cameras")
        self._capture = cv2.VideoCapture(str(Path(name).resolve()) if "://" not in name else name)
        if not self._capture.isOpened():
            raise InputError(f"camera: {name}: cannot be opened; busy, no permission, or no video")
        self._name, self._count, self._last = name, 0, time.monotonic()

    @property
    def identity(self) -> Identity:
        """Its path."""
        return Identity("opencv", self._capture.getBackendName(), "", f"opencv:{self._name}")

    def configure(self, wanted: Wanted) -> Accepted:
        """Set and read back; settings that did not hold are listed as unlocked."""
        unlocked = []
        if wanted.rows and wanted.cols:
            self._set(cv2.CAP_PROP_FRAME_HEIGHT, wanted.rows)
            self._set(cv2.CAP_PROP_FRAME_WIDTH, wanted.cols)
        if wanted.fps is not None:
            self._set(cv2.CAP_PROP_FPS, wanted.fps)
        if not any(self._set(cv2.CAP_PROP_AUTO_EXPOSURE, value) == value for value in _MANUAL):
            unlocked.append("exposure: automatic exposure cannot be switched off")
        units = (
            wanted.exposure_s / _EXPOSURE_UNIT_S if sys.platform == "linux" else np.log2(wanted.exposure_s)
        )
        exposure = self._set(cv2.CAP_PROP_EXPOSURE, float(units))
        accepted = exposure * _EXPOSURE_UNIT_S if sys.platform == "linux" else 2.0**exposure
        if not 0.5 < accepted / wanted.exposure_s < 2:
            unlocked.append(f"exposure: the driver answers {exposure:g} to {float(units):g}")
            accepted = wanted.exposure_s
        gain = None if wanted.gain is None else self._set(cv2.CAP_PROP_GAIN, wanted.gain)
        self._set(cv2.CAP_PROP_AUTO_WB, 0)
        rows, cols = (
            int(self._capture.get(p)) for p in (cv2.CAP_PROP_FRAME_HEIGHT, cv2.CAP_PROP_FRAME_WIDTH)
        )
        fps = float(self._capture.get(cv2.CAP_PROP_FPS)) or None
        return Accepted(accepted, rows, cols, gain=gain, fps=fps, unlocked=tuple(unlocked))

    def _set(self, what: int, value: float) -> float:
        self._capture.set(what, value)
        return float(self._capture.get(what))

    def start(self) -> None:
        """Runs from its opening on."""
        self._last = time.monotonic()

    def trigger(self) -> float:
        """InputError: OpenCV has none."""
        raise InputError("camera: OpenCV has no software trigger, trigger must be free")

    def next(self, timeout_s: float) -> Image | None:
        """Blocks until the driver hands out an image; CameraLost after 5 s of refusals."""
        del timeout_s
        done, frame = self._capture.read()
        now = time.monotonic()
        if not done:
            if now - self._last > _GONE_S:
                raise CameraLost(f"camera: {self._name} gave no image for {_GONE_S:g} s; is it plugged in?")
            time.sleep(0.01)
            return None
        self._last, self._count = now, self._count + 1
        return Image(_grey(frame), None, None, now)

    def stop(self) -> None:
        """Runs until it is closed."""

    def close(self) -> None:
        """Give the camera back."""
        self._capture.release()


def _grey(frame: Any) -> Any:
    return frame if frame.ndim == 2 else cv2.cvtColor(frame, cv2.COLOR_BGR2GRAY)
