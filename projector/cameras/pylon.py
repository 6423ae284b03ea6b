"""Basler's cameras by pypylon (extra `basler`; its wheel holds Basler's own runtime, which is not free)."""

import importlib
import time
from typing import Any

from optolever.errors import InputError

from ..devices import Accepted, CameraLost, Identity, Image, Wanted, no_pixels

__all__ = ["PylonCamera", "find", "open_named"]

_TRIGGER_S = 1.0


def _pylon() -> Any:
    try:
        return importlib.import_module("pypylon.pylon")
    except ImportError as error:
        raise InputError("camera: pypylon is not installed; pip install 'optolever[basler]'") from error


def find() -> list[Identity]:
    """Connected ones. InputError without pypylon."""
    devices = _pylon().TlFactory.GetInstance().EnumerateDevices()
    return [
        Identity("basler", one.GetModelName(), one.GetSerialNumber(), f"basler:{one.GetSerialNumber()}")
        for one in devices
    ]


def open_named(name: str) -> "PylonCamera":
    """By serial number."""
    return PylonCamera(name)


class PylonCamera:
    """`lost` as pypylon counts blocks that were skipped."""

    def __init__(self, serial: str) -> None:
        self._pylon, self._serial, self.lost = _pylon(), serial, 0
        factory = self._pylon.TlFactory.GetInstance()
        fitting = [one for one in factory.EnumerateDevices() if one.GetSerialNumber() == serial]
        if not fitting:
            raise InputError(f"camera: basler:{serial} is not connected")
        try:
            self._camera = self._pylon.InstantCamera(factory.CreateDevice(fitting[0]))
            self._camera.Open()
        except Exception as error:  # pypylon's own classes
            raise InputError(f"camera: basler:{serial}: {error}") from error
        self._model = fitting[0].GetModelName()
        self._last: int | None = None

    @property
    def identity(self) -> Identity:
        """Model and serial."""
        return Identity("basler", self._model, self._serial, f"basler:{self._serial}")

    def configure(self, wanted: Wanted) -> Accepted:
        """InputError names what the camera refuses."""
        camera, unlocked = self._camera, []
        try:
            for name, what in (("ExposureAuto", "exposure"), ("GainAuto", "gain")):
                if not self._try(name, "Off") and hasattr(camera, name):
                    unlocked.append(f"{what}: automatic")
            camera.PixelFormat.Value = f"Mono{wanted.bits}"
            camera.Width.Value = wanted.cols or camera.Width.Max
            camera.Height.Value = wanted.rows or camera.Height.Max
            camera.OffsetX.Value, camera.OffsetY.Value = wanted.col, wanted.row
            exposure = next(name for name in ("ExposureTime", "ExposureTimeAbs") if self._has(name))
            getattr(camera, exposure).Value = 1e6 * wanted.exposure_s
            camera.TriggerSelector.Value = "FrameStart"
            camera.TriggerMode.Value = "Off" if wanted.trigger == "free" else "On"
            if wanted.trigger != "free":
                camera.TriggerSource.Value = "Software" if wanted.trigger == "software" else "Line1"
            if wanted.fps is not None:
                self._try("AcquisitionFrameRateEnable", True)
                self._try("AcquisitionFrameRate", wanted.fps) or self._try(
                    "AcquisitionFrameRateAbs", wanted.fps
                )
            gain = wanted.gain if wanted.gain is not None and self._try("Gain", wanted.gain) else None
            return Accepted(
                exposure_s=1e-6 * float(getattr(camera, exposure).Value),
                rows=int(camera.Height.Value),
                cols=int(camera.Width.Value),
                row=int(camera.OffsetY.Value),
                col=int(camera.OffsetX.Value),
                bits=wanted.bits,
                gain=gain,
                fps=wanted.fps,
                trigger=wanted.trigger,
                unlocked=tuple(unlocked),
            )
        except self._pylon.GenericException as error:
            raise InputError(f"camera: basler:{self._serial} refuses its settings: {error}") from error

    def _has(self, name: str) -> bool:
        return bool(self._pylon.IsReadable(self._camera.GetNodeMap().GetNode(name)))

    def _try(self, name: str, value: object) -> bool:
        if not self._has(name):
            return False
        getattr(self._camera, name).Value = value
        return True

    def start(self) -> None:
        """Images in order."""
        self._last = None
        self._camera.StartGrabbing(self._pylon.GrabStrategy_OneByOne)

    def trigger(self) -> float:
        """CameraLost where it does not take one within a second."""
        try:
            self._camera.WaitForFrameTriggerReady(
                round(1e3 * _TRIGGER_S), self._pylon.TimeoutHandling_ThrowException
            )
            sent = time.monotonic()
            self._camera.ExecuteSoftwareTrigger()
        except self._pylon.GenericException as error:
            raise CameraLost(f"camera: basler:{self._serial} does not take a trigger: {error}") from error
        return sent

    def next(self, timeout_s: float) -> Image | None:
        """The oldest that waits; failed ones are not complete."""
        if self._camera.IsCameraDeviceRemoved():
            raise CameraLost(f"camera: basler:{self._serial} is gone: unplugged, or without power")
        wait = round(1e3 * max(timeout_s, 0.0))
        result = self._camera.RetrieveResult(wait, self._pylon.TimeoutHandling_Return)
        if not result.IsValid():
            return None
        with result:
            arrived, number = time.monotonic(), int(result.BlockID)
            complete = bool(result.GrabSucceeded())
            pixels = result.Array.copy() if complete else no_pixels()
            device = 1e-9 * result.TimeStamp if result.TimeStamp else None
            why = "" if complete else str(result.ErrorDescription)
        if self._last is not None and number > self._last:
            self.lost += number - self._last - 1
        self._last = number
        return Image(pixels, number, device, arrived, complete, why)

    def stop(self) -> None:
        """Take no more."""
        self._camera.StopGrabbing()

    def close(self) -> None:
        """Give the camera back."""
        self._camera.Close()
