"""A GigE Vision camera on loopback whose pixels, counter and losses are ours: Aravis' fake camera by ctypes.

    with GigEHost(sensor, serial="TEST-1") as host: ...

sensor(request) -> array (rows, cols) uint8 or uint16, called in Aravis' own thread.
"""

import ctypes as C
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Self

import numpy as np

POINTER = C.c_void_p
FILL = C.CFUNCTYPE(None, POINTER, POINTER, C.c_uint32, C.c_uint32, C.c_uint32)
MONO8 = 0x01080001


@dataclass
class Request:
    """What the camera is asked for; frame_id and device_ns may be changed."""

    rows: int
    cols: int
    exposure_s: float
    bits: int
    frame_id: int
    device_ns: int


def library() -> Any:
    """Aravis with the prototypes of its fake camera."""
    aravis = C.CDLL("libaravis-0.8.so.0")
    for name, result, *arguments in (
        ("gv_fake_camera_new", POINTER, C.c_char_p, C.c_char_p),
        ("gv_fake_camera_is_running", C.c_int, POINTER),
        ("gv_fake_camera_get_fake_camera", POINTER, POINTER),
        ("fake_camera_set_fill_pattern", None, POINTER, FILL, POINTER, POINTER),
        ("fake_camera_set_trigger_frequency", None, POINTER, C.c_double),
        ("buffer_get_data", POINTER, POINTER, C.POINTER(C.c_size_t)),
        ("buffer_get_frame_id", C.c_uint64, POINTER),
        ("buffer_set_frame_id", None, POINTER, C.c_uint64),
        ("buffer_set_timestamp", None, POINTER, C.c_uint64),
        ("buffer_get_image_width", C.c_int, POINTER),
        ("buffer_get_image_height", C.c_int, POINTER),
    ):
        function = getattr(aravis, f"arv_{name}")
        function.restype, function.argtypes = result, arguments
    return aravis


@dataclass
class GigEHost:
    """Runs inside its block; what the sensor raised is raised at its end."""

    sensor: Callable[[Request], Any]
    serial: str = "TEST-1"
    errors: list[BaseException] = field(default_factory=list)

    def __enter__(self) -> Self:
        self._aravis, self._objects = library(), C.CDLL("libgobject-2.0.so.0")
        self._host = self._aravis.arv_gv_fake_camera_new(b"127.0.0.1", self.serial.encode())
        assert self._aravis.arv_gv_fake_camera_is_running(self._host), "port 3956 is taken"
        camera = self._aravis.arv_gv_fake_camera_get_fake_camera(self._host)
        self._callback = FILL(self._fill)
        self._aravis.arv_fake_camera_set_fill_pattern(camera, self._callback, None, None)
        self._aravis.arv_fake_camera_set_trigger_frequency(camera, 1000.0)
        return self

    def lose(self, share: float) -> None:
        """Share of the packets that are not sent from now on."""
        self._objects.g_object_set.argtypes = None
        self._objects.g_object_set(POINTER(self._host), b"gvsp-lost-ratio", C.c_double(share), POINTER(None))

    def _fill(self, buffer: int, _: int, exposure_us: int, gain: int, pixel_format: int) -> None:
        aravis = self._aravis
        try:
            size = C.c_size_t()
            where = aravis.arv_buffer_get_data(buffer, C.byref(size))
            shape = aravis.arv_buffer_get_image_height(buffer), aravis.arv_buffer_get_image_width(buffer)
            bits, number = 8 if pixel_format == MONO8 else 16, aravis.arv_buffer_get_frame_id(buffer)
            request = Request(*shape, 1e-6 * exposure_us, bits, number, time.monotonic_ns())
            image = np.ascontiguousarray(self.sensor(request), np.uint8 if bits == 8 else np.uint16)
            assert image.shape == shape
            C.memmove(where, image.ctypes.data, image.nbytes)
            aravis.arv_buffer_set_timestamp(buffer, request.device_ns)
            if request.frame_id != number:
                aravis.arv_buffer_set_frame_id(buffer, request.frame_id)
        except BaseException as error:  # a callback of C cannot raise
            self.errors.append(error)

    def stop(self) -> None:
        """As if it were unplugged."""
        if self._host:
            self._objects.g_object_unref.argtypes = [POINTER]
            self._objects.g_object_unref(self._host)
            self._host = None

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        self.stop()
        if self.errors and error is None:
            raise self.errors[0]
