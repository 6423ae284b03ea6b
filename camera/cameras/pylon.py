"""Basler's cameras by pypylon (extra `basler`); PYLON_CAMEMU=N makes N emulated ones."""

import time
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
from numpy.typing import NDArray

from optolever.errors import InputError
from optolever.projector import Accepted, CameraLost, Identity, Image, Wanted, no_pixels

from .aravis import AUTOMATIC, COLOURED, FORMATS
from .pixel_formats import mosaic_of, no_format, unpacked

__all__ = ["PylonCamera", "find", "open_named"]

#: Names of older cameras after those of newer ones.
_EXPOSURE, _GAIN = ("ExposureTime", "ExposureTimeAbs"), ("Gain", "GainRaw")
_RATE, _ON = ("AcquisitionFrameRate", "AcquisitionFrameRateAbs"), ("AcquisitionFrameRateEnable",)
_RESULTING = ("ResultingFrameRate", "ResultingFrameRateAbs", "BslResultingAcquisitionFrameRate")


def _pypylon() -> tuple[Any, Any]:
    """pylon and genicam. InputError without the extra."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of SWIG, in which they end the program where they are errors
            from pypylon import genicam, pylon
    except ImportError as error:
        raise InputError("camera: pypylon is not installed; pip install 'optolever[basler]'") from error
    return pylon, genicam


def find() -> list[Identity]:
    """Cameras that answer. InputError without the extra."""
    return [_identity(one) for one in _pypylon()[0].TlFactory.GetInstance().EnumerateDevices()]


def _identity(device: Any) -> Identity:
    return Identity(
        "pylon", device.GetModelName(), device.GetSerialNumber(), f"pylon:{device.GetSerialNumber()}"
    )


class PylonCamera:
    """`lost` by gaps of the counter."""

    def __init__(self, serial: str) -> None:
        self._pylon, self._genicam = _pypylon()
        self._serial, self.lost, self._format = serial, 0, ""
        self._last: int | None = None
        wanted, factory = self._pylon.DeviceInfo(), self._pylon.TlFactory.GetInstance()
        wanted.SetSerialNumber(serial)
        with self._named("is not connected, or busy"):
            self._camera = self._pylon.InstantCamera(factory.CreateDevice(wanted))
            self._camera.Open()
        self.identity = _identity(self._camera.GetDeviceInfo())
        self._tick_s = 1 / float(self._get(("GevTimestampTickFrequency",)) or 1e9)  # ns, but for older ones

    @contextmanager
    def _named(self, fault: str, kind: type[InputError] = InputError) -> Iterator[None]:
        """Pylon's errors, with the camera's address and without their place in pylon's source."""
        try:
            yield
        except self._genicam.GenericException as error:
            reason = str(error).partition(" : ")[0]
            raise kind(f"camera: pylon:{self._serial} {fault}: {reason}") from error

    def configure(self, wanted: Wanted) -> Accepted:
        """InputError names a setting that the camera refuses."""
        with self._named("refuses its settings"):
            unlocked = [
                f"{what}: automatic" for name, what in AUTOMATIC if self._set((name,), "Off") is False
            ]
            offered = self._camera.PixelFormat.Symbolics
            names = (COLOURED if wanted.colour else FORMATS).get(wanted.bits, ())
            self._format = next((one for one in names if one in offered), "")
            if not self._format:
                raise no_format(self.identity.address, wanted.colour, wanted.bits, " ".join(offered))
            self._camera.PixelFormat.Value = self._format
            for size, offset, pixels, first in (
                (self._camera.Width, ("OffsetX",), wanted.cols, wanted.col),
                (self._camera.Height, ("OffsetY",), wanted.rows, wanted.row),
            ):
                self._set(offset, 0)  # limits the size
                size.Value = pixels or size.Max
                self._set(offset, first)
            self._set(("TriggerSelector",), "FrameStart")
            self._set(("TriggerMode",), "Off" if wanted.trigger == "free" else "On")
            self._set(("TriggerSource",), "Line1" if wanted.trigger == "hardware" else "Software")
            self._set(_ON, wanted.fps is not None)
            if wanted.fps is not None:
                self._set(_RATE, wanted.fps)
            self._set(_EXPOSURE, 1e6 * wanted.exposure_s)
            if wanted.gain is not None:
                self._set(_GAIN, wanted.gain)
            rows, cols, row, col = (
                int(self._get((name,)) or 0) for name in ("Height", "Width", "OffsetY", "OffsetX")
            )
            gain = None if wanted.gain is None else float(self._get(_GAIN) or 0.0)
            exposure, rate = 1e-6 * float(self._get(_EXPOSURE) or 0.0), self._get(_RESULTING)
            return Accepted(
                exposure, rows, cols, row, col, wanted.bits, gain, rate, wanted.trigger,
                unlocked=tuple(unlocked), mosaic=mosaic_of(self._format),
            )  # fmt: skip

    def _node(self, names: tuple[str, ...]) -> Any:
        """The first feature of these that the camera has, or None."""
        every = (self._camera.GetNodeMap().GetNode(name) for name in names)
        return next((node for node in every if self._genicam.IsReadable(node)), None)

    def _get(self, names: tuple[str, ...]) -> Any:
        node = self._node(names)
        return None if node is None else node.Value

    def _set(self, names: tuple[str, ...], value: Any) -> bool | None:
        """Set a feature, if that is possible; None: the camera has none."""
        node = self._node(names)
        settable = None if node is None else bool(self._genicam.IsWritable(node))
        if settable:
            node.Value = type(node.Value)(value)
        return settable

    def start(self) -> None:
        """Images wait in their order."""
        self._last = None
        with self._named("does not start"):
            self._camera.StartGrabbing(self._pylon.GrabStrategy_OneByOne)

    def trigger(self) -> float:
        """CameraLost where the camera does not take it."""
        sent = time.monotonic()
        with self._named("does not answer", CameraLost):
            self._camera.TriggerSoftware.Execute()
        return sent

    def next(self, timeout_s: float) -> Image | None:
        """The oldest image that waits. CameraLost."""
        wait = round(1e3 * max(timeout_s, 0.0))
        with self._named("is gone", CameraLost):
            found = self._camera.RetrieveResult(wait, self._pylon.TimeoutHandling_Return)
        arrived = time.monotonic()
        if not found.IsValid() and self._camera.IsCameraDeviceRemoved():
            raise CameraLost(f"camera: {self.identity.address} is gone: unplugged, or without power")
        if not found.IsValid():
            return None
        complete, number = bool(found.GrabSucceeded()), int(found.BlockID)
        self.lost += 0 if self._last is None else max(number - self._last - 1, 0)
        self._last = number
        pixels, why = (self._pixels(found), "") if complete else (no_pixels(), found.ErrorDescription)
        device = found.TimeStamp * self._tick_s or None
        found.Release()
        return Image(pixels, number, device, arrived, complete, why)

    def _pixels(self, found: Any) -> NDArray[Any]:
        """A copy: the buffer goes back."""
        if not self._format.endswith(("p", "Packed")):
            return np.array(found.Array)
        raw = np.frombuffer(found.GetBuffer(), np.uint8)
        return unpacked(raw, (found.Height, found.Width), self._format)

    def stop(self) -> None:
        """Take no more images."""
        self._camera.StopGrabbing()

    def close(self) -> None:
        """Give the camera back."""
        self._camera.Close()


open_named = PylonCamera  # by serial
