"""Aravis 0.8 by ctypes: prototypes, errors of GLib, texts."""

import ctypes as C
from functools import lru_cache
from typing import Any

from optolever.errors import InputError

__all__ = ["LOST", "Glib", "GlibError", "aravis"]

_POINTER, _TEXT, _INT, _UINT, _REAL = C.c_void_p, C.c_char_p, C.c_int, C.c_uint, C.c_double
_LONG, _INTS = C.c_uint64, C.POINTER(C.c_int)


class _GError(C.Structure):
    _fields_ = (("domain", C.c_uint32), ("code", C.c_int), ("message", C.c_char_p))


_ERROR = C.POINTER(C.POINTER(_GError))
LOST = C.CFUNCTYPE(None, C.c_void_p, C.c_void_p)

#: Name without arv_: result, arguments; an _ERROR at the end is given by `Glib.call`.
_PROTOTYPES: dict[str, tuple[Any, ...]] = {
    "update_device_list": (None,),
    "get_n_devices": (_UINT,),
    **{f"get_device_{name}": (_TEXT, _UINT) for name in ("id", "model", "serial_nbr", "address", "protocol")},
    "camera_new": (_POINTER, _TEXT, _ERROR),
    "camera_get_device": (_POINTER, _POINTER),
    "camera_get_model_name": (_TEXT, _POINTER, _ERROR),
    "camera_get_device_serial_number": (_TEXT, _POINTER, _ERROR),
    "camera_is_gv_device": (_INT, _POINTER),
    "camera_get_payload": (_UINT, _POINTER, _ERROR),
    "camera_create_stream": (_POINTER, _POINTER, _POINTER, _POINTER, _ERROR),
    "camera_start_acquisition": (None, _POINTER, _ERROR),
    "camera_stop_acquisition": (None, _POINTER, _ERROR),
    "camera_software_trigger": (None, _POINTER, _ERROR),
    "camera_set_trigger": (None, _POINTER, _TEXT, _ERROR),
    "camera_clear_triggers": (None, _POINTER, _ERROR),
    "camera_is_feature_available": (_INT, _POINTER, _TEXT, _ERROR),
    "camera_set_string": (None, _POINTER, _TEXT, _TEXT, _ERROR),
    **{
        f"camera_set_{name}": (None, _POINTER, _REAL, _ERROR)
        for name in ("exposure_time", "gain", "frame_rate")
    },
    **{f"camera_get_{name}": (_REAL, _POINTER, _ERROR) for name in ("exposure_time", "gain", "frame_rate")},
    "camera_set_pixel_format_from_string": (None, _POINTER, _TEXT, _ERROR),
    "camera_set_region": (None, _POINTER, _INT, _INT, _INT, _INT, _ERROR),
    "camera_get_region": (None, _POINTER, _INTS, _INTS, _INTS, _INTS, _ERROR),
    "camera_get_sensor_size": (None, _POINTER, _INTS, _INTS, _ERROR),
    "gv_device_is_controller": (_INT, _POINTER),
    "buffer_new": (_POINTER, C.c_size_t, _POINTER),
    "stream_push_buffer": (None, _POINTER, _POINTER),
    "stream_timeout_pop_buffer": (_POINTER, _POINTER, _LONG),
    "buffer_get_status": (_INT, _POINTER),
    "buffer_get_frame_id": (_LONG, _POINTER),
    "buffer_get_timestamp": (_LONG, _POINTER),
    "buffer_get_system_timestamp": (_LONG, _POINTER),
    "buffer_get_data": (_POINTER, _POINTER, C.POINTER(C.c_size_t)),
    "buffer_get_image_width": (_INT, _POINTER),
    "buffer_get_image_height": (_INT, _POINTER),
}


class GlibError(OSError):
    """An error of an Aravis function."""


class Glib:
    """The library with its prototypes set; `call` raises the message of a GError."""

    def __init__(self, library: C.CDLL, objects: C.CDLL) -> None:
        self._functions = {}
        for name, (result, *arguments) in _PROTOTYPES.items():
            function = getattr(library, f"arv_{name}")
            function.restype, function.argtypes = result, arguments
            self._functions[name] = function
        self._connect, self._unref, self._error_free = (
            objects.g_signal_connect_data,
            objects.g_object_unref,
            objects.g_error_free,
        )
        self._connect.restype = C.c_ulong
        self._connect.argtypes = [_POINTER, _TEXT, _POINTER, _POINTER, _POINTER, _INT]
        self._unref.argtypes, self._error_free.argtypes = [_POINTER], [_POINTER]

    def call(self, name: str, *arguments: Any) -> Any:
        """The function's result. GlibError."""
        function = self._functions[name]
        if not function.argtypes or function.argtypes[-1] is not _ERROR:
            return function(*arguments)
        error = C.POINTER(_GError)()
        result = function(*arguments, C.byref(error))
        if error:
            message = error.contents.message.decode(errors="replace")
            self._error_free(error)
            raise GlibError(message)
        return result

    def text(self, name: str, *arguments: Any) -> str:
        """The same of a function that returns a text."""
        return (self.call(name, *arguments) or b"").decode(errors="replace")

    def connect(self, instance: int, signal: str, function: Any) -> None:
        """Call a C function when the object emits a signal; the caller keeps the function alive."""
        self._connect(instance, signal.encode(), C.cast(function, _POINTER), None, None, 0)

    def unref(self, instance: int) -> None:
        """Give an object back."""
        self._unref(instance)


@lru_cache(maxsize=1)
def aravis() -> Glib:
    """The library. InputError where it is not installed."""
    try:
        return Glib(C.CDLL("libaravis-0.8.so.0"), C.CDLL("libgobject-2.0.so.0"))
    except OSError as error:
        raise InputError(
            f"camera: Aravis 0.8 is not installed ({error}); on Debian: apt-get install libaravis-0.8-0"
        ) from error
