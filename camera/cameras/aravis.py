"""GigE Vision and USB3 Vision cameras of any maker, by Aravis 0.8: counter, device clock, missing packets."""

import ctypes as C
import math
import time
from contextlib import suppress

import numpy as np
from numpy.typing import NDArray

from optolever.errors import InputError
from optolever.projector import Accepted, CameraLost, Identity, Image, Wanted, no_pixels

from .aravis_library import LOST, GlibError, aravis
from .pixel_formats import mosaic_of, no_format, unpacked

__all__ = ["AUTOMATIC", "COLOURED", "FORMATS", "AravisCamera", "find", "open_named"]

_STATUS = (
    "success", "cleared", "timeout", "missing packets", "wrong packet id", "size mismatch", "filling",
    "aborted",
)  # fmt: skip
_BUFFERS = 8
_IDS = 65535  # of GVSP: 16 bits, 0 is skipped
#: Formats by bits, best first: grey, and of colours.
FORMATS = {
    8: ("Mono8",),
    **{bits: tuple(f"Mono{bits}{packing}" for packing in ("", "p", "Packed")) for bits in (10, 12)},
    16: ("Mono16",),
}
COLOURED = {bits: tuple(f"Bayer{order}{bits}" for order in ("RG", "GB", "GR", "BG")) for bits in FORMATS}
COLOURED[8] += ("RGB8", "RGB8Packed")
#: GenICam's features to switch off, in words.
AUTOMATIC = (("ExposureAuto", "exposure"), ("GainAuto", "gain"), ("BalanceWhiteAuto", "white balance"))


def find() -> list[Identity]:
    """Cameras that answer within a second. InputError without the library."""
    library = aravis()
    library.call("update_device_list")
    found = []
    for index in range(library.call("get_n_devices")):
        name, model, serial, address, protocol = (
            library.text(f"get_device_{key}", index)
            for key in ("id", "model", "serial_nbr", "address", "protocol")
        )
        prefix = f"gige:{address}" if protocol == "GigEVision" else f"aravis:{name}"
        found.append(Identity("aravis", model, serial, prefix))
    return found


def open_named(name: str) -> "AravisCamera":
    """By address or by Aravis' name."""
    return AravisCamera(name)


class AravisCamera:
    """`lost` by gaps of the counter. A camera that another program controls is refused at once."""

    def __init__(self, name: str) -> None:
        self._library, self._name, self.lost = aravis(), name, 0
        self._stream: int | None = None
        self._last: int | None = None
        self._gone, self._format = False, ""
        try:
            self._camera: int | None = self._library.call("camera_new", name.encode())
        except GlibError as error:
            raise InputError(f"camera: {name}: {error} (optolever doctor)") from error
        device = self._library.call("camera_get_device", self._camera)
        self._gige = bool(self._library.call("camera_is_gv_device", self._camera))
        if self._gige and not self._library.call("gv_device_is_controller", device):
            self._drop()
            raise InputError(f"camera: {name}: busy, another program controls it")
        self._on_lost = LOST(self._note_loss)  # kept alive with the camera
        self._library.connect(device, "control-lost", self._on_lost)

    def _note_loss(self, *_: object) -> None:
        self._gone = True

    def _drop(self) -> None:
        if self._camera is not None:
            self._library.unref(self._camera)
            self._camera = None

    @property
    def identity(self) -> Identity:
        """Model and serial as the camera states them."""
        model = self._library.text("camera_get_model_name", self._camera)
        serial = self._library.text("camera_get_device_serial_number", self._camera)
        return Identity("aravis", model, serial, f"{'gige' if self._gige else 'aravis'}:{self._name}")

    def configure(self, wanted: Wanted) -> Accepted:
        """InputError names a setting that the camera refuses."""
        try:
            return self._configure(wanted)
        except GlibError as error:
            raise InputError(f"camera: {self._name} refuses its settings: {error}") from error

    def _configure(self, wanted: Wanted) -> Accepted:
        call, camera = self._library.call, self._camera
        if wanted.bits not in FORMATS:
            raise InputError(f"camera: bits {wanted.bits}, must be one of {', '.join(map(str, FORMATS))}")
        unlocked = []
        for feature, what in AUTOMATIC:
            if call("camera_is_feature_available", camera, feature.encode()):
                try:
                    call("camera_set_string", camera, feature.encode(), b"Off")
                except GlibError as error:
                    unlocked.append(f"{what}: automatic ({error})")
        for self._format in (COLOURED if wanted.colour else FORMATS)[wanted.bits]:
            with suppress(GlibError):
                call("camera_set_pixel_format_from_string", camera, self._format.encode())
                break
        else:
            raise no_format(self._name, wanted.colour, wanted.bits)
        width, height = C.c_int(), C.c_int()
        call("camera_get_sensor_size", camera, C.byref(width), C.byref(height))
        rows, cols = wanted.rows or height.value, wanted.cols or width.value
        call("camera_set_region", camera, wanted.col, wanted.row, cols, rows)
        if wanted.trigger == "free":
            call("camera_clear_triggers", camera)
        else:
            call("camera_set_trigger", camera, b"Software" if wanted.trigger == "software" else b"Line1")
        if wanted.fps is not None and wanted.trigger == "free":
            call("camera_set_frame_rate", camera, float(wanted.fps))
        call("camera_set_exposure_time", camera, 1e6 * wanted.exposure_s)
        if wanted.gain is not None:
            call("camera_set_gain", camera, float(wanted.gain))
        region = [C.c_int() for _ in range(4)]
        call("camera_get_region", camera, *map(C.byref, region))
        col, row, cols, rows = (one.value for one in region)
        return Accepted(
            exposure_s=1e-6 * call("camera_get_exposure_time", camera),
            rows=rows,
            cols=cols,
            row=row,
            col=col,
            bits=wanted.bits,
            gain=float(call("camera_get_gain", camera)) if wanted.gain is not None else None,
            fps=float(call("camera_get_frame_rate", camera)),
            trigger=wanted.trigger,
            unlocked=tuple(unlocked),
            mosaic=mosaic_of(self._format),
        )

    def start(self) -> None:
        """InputError where the camera does not begin."""
        call = self._library.call
        try:
            self._stream = call("camera_create_stream", self._camera, None, None)
            size = call("camera_get_payload", self._camera)
            for _ in range(_BUFFERS):
                call("stream_push_buffer", self._stream, call("buffer_new", size, None))
            self._last = None
            call("camera_start_acquisition", self._camera)
        except GlibError as error:
            self._end_stream()
            raise InputError(f"camera: {self._name} does not start: {error}") from error

    def trigger(self) -> float:
        """CameraLost where the camera does not take it."""
        sent = time.monotonic()
        try:
            self._library.call("camera_software_trigger", self._camera)
        except GlibError as error:
            raise CameraLost(f"camera: {self._name} does not answer: {error}") from error
        return sent

    def next(self, timeout_s: float) -> Image | None:
        """The oldest image that waits. Of an incomplete one nothing but its counter is read."""
        call = self._library.call
        buffer = call("stream_timeout_pop_buffer", self._stream, round(1e6 * max(timeout_s, 0.0)))
        if not buffer:
            if self._gone:
                raise CameraLost(f"camera: {self._name} is gone: unplugged, or without power")
            return None
        wall = time.time()  # by which Aravis stamps arrivals; read first, a pause makes it late, never early
        to_monotonic = time.monotonic() - wall
        status = call("buffer_get_status", buffer)
        complete = status == 0
        pixels = self._pixels(buffer) if complete else no_pixels()
        number = int(call("buffer_get_frame_id", buffer))
        device = 1e-9 * call("buffer_get_timestamp", buffer)
        arrived = 1e-9 * call("buffer_get_system_timestamp", buffer) + to_monotonic
        call("stream_push_buffer", self._stream, buffer)
        if self._last is not None:
            gap = (number - self._last) % _IDS if self._gige else number - self._last
            self.lost += gap - 1 if 1 < gap < _IDS // 2 else 0
        self._last = number
        why = "" if complete else _STATUS[status] if 0 < status < len(_STATUS) else f"status {status}"
        return Image(pixels, number, device or None, arrived, complete, why)

    def _pixels(self, buffer: int) -> NDArray[np.uint8] | NDArray[np.uint16]:
        """A copy: the buffer goes back."""
        call = self._library.call
        rows, cols = call("buffer_get_image_height", buffer), call("buffer_get_image_width", buffer)
        size = C.c_size_t()
        data = call("buffer_get_data", buffer, C.byref(size))
        if self._format.endswith(("p", "Packed")):
            raw = np.ctypeslib.as_array(C.cast(data, C.POINTER(C.c_uint8)), (size.value,))
            return unpacked(raw, (rows, cols), self._format)
        shape = (rows, cols, 3) if mosaic_of(self._format) == "RGB" else (rows, cols)
        wide = size.value >= 2 * math.prod(shape)
        pixels = np.empty(shape, np.uint16 if wide else np.uint8)
        C.memmove(pixels.ctypes.data, data, min(pixels.nbytes, size.value))
        return pixels

    def stop(self) -> None:
        """A camera that is gone takes no commands."""
        if self._stream is None:
            return
        try:
            self._library.call("camera_stop_acquisition", self._camera)
        except GlibError:
            self._gone = True
        self._end_stream()

    def _end_stream(self) -> None:
        if self._stream is not None:
            self._library.unref(self._stream)
            self._stream = None

    def close(self) -> None:
        """Give the camera back; one that comes back is opened anew."""
        self.stop()
        self._drop()
