"""python examples/ros2_mcap.py RECORDING FILE.mcap: a recording for ROS 2 tools (needs the package mcap).

Images on /camera, swaps and refused images on /log. Where the recording holds readings (`live --record`),
they are computed again: /heights and /contacts as PointCloud2, /wrench as WrenchStamped, what objects exert
on the mirror, about the frame's origin; of frames that are trusted. Lengths are metres in the frame `mirror`
(x from the edge that it shares with the display, z into the prism: a dent is z > 0).

Messages are `ros2msg` in CDR, little endian. Times are nanoseconds of the wall clock as it was when the
recording began: the log's is the image's stamp, the other its arrival.
"""

import json
import struct
import sys
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from mcap.writer import Writer
from numpy.typing import NDArray

from optolever.camera import Recording
from optolever.files import atomic_file
from optolever.live import Reading, has_readings, replayed
from optolever.projector import Image, Shown

__all__ = ["write_mcap"]

_BAR = "=" * 80
_HEADER = f"""
{_BAR}
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
{_BAR}
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
"""
_IMAGE = """std_msgs/Header header
uint32 height
uint32 width
string encoding
uint8 is_bigendian
uint32 step
uint8[] data"""
_CLOUD = f"""std_msgs/Header header
uint32 height
uint32 width
sensor_msgs/PointField[] fields
bool is_bigendian
uint32 point_step
uint32 row_step
uint8[] data
bool is_dense
{_BAR}
MSG: sensor_msgs/PointField
string name
uint32 offset
uint8 datatype
uint32 count"""
_WRENCH = f"""std_msgs/Header header
geometry_msgs/Wrench wrench
{_BAR}
MSG: geometry_msgs/Wrench
geometry_msgs/Vector3 force
geometry_msgs/Vector3 torque
{_BAR}
MSG: geometry_msgs/Vector3
float64 x
float64 y
float64 z"""
_TOPICS = {
    "/log": ("std_msgs/msg/String", "string data\n"),
    "/camera": ("sensor_msgs/msg/Image", _IMAGE + _HEADER),
    "/heights": ("sensor_msgs/msg/PointCloud2", _CLOUD + _HEADER),
    "/contacts": ("sensor_msgs/msg/PointCloud2", _CLOUD + _HEADER),
    "/wrench": ("geometry_msgs/msg/WrenchStamped", _WRENCH + _HEADER),
}
_FLOAT32 = 7  # of sensor_msgs/PointField


def write_mcap(folder: str | Path, path: str | Path) -> int:
    """Write all complete images, all events and all readings; the number of images."""
    recording, count = Recording(folder), 0
    offset = recording.about.get("wall_less_monotonic_s", 0.0)
    with atomic_file(Path(path)) as temporary, temporary.open("wb") as file:
        writer: Any = Writer(file)  # in part without types
        writer.start("ros2", "optolever")
        channels = {
            topic: writer.register_channel(
                topic, "cdr", writer.register_schema(name, "ros2msg", text.encode())
            )
            for topic, (name, text) in _TOPICS.items()
        }

        def nanoseconds(seconds: float) -> int:
            return round(1e9 * (seconds + offset))

        def send(topic: str, time: int, message: "_Cdr", arrived: int | None = None, number: int = 0) -> None:
            data = b"\0\1\0\0" + bytes(message.data)  # encapsulation: plain, little endian
            writer.add_message(channels[topic], time, data, arrived or time, number % 2**32)

        def log(values: dict[str, Any], time: int) -> None:
            send("/log", time, _Cdr().text(json.dumps(values)))

        log(recording.about, nanoseconds(0) if offset else 0)
        for event in recording:
            if isinstance(event, Shown):
                log({"event": "shown", **asdict(event)}, nanoseconds(event.swapped_s))
                continue
            image, stamp = event.image, nanoseconds(event.stamp_s)
            if not image.complete:
                log({"event": "incomplete", "id": image.id, "why": image.why}, stamp)
                continue
            send("/camera", stamp, _image(image, stamp), nanoseconds(image.arrived_s), image.id or count)
            count += 1
        for one in replayed(folder) if has_readings(folder) else ():
            reading = one.followed.reading
            if reading.trusted:
                stamp = nanoseconds(reading.time)
                send("/heights", stamp, _heights(reading, stamp))
                send("/contacts", stamp, _contacts(reading, stamp))
                send("/wrench", stamp, _wrench(reading, stamp))
        writer.finish()
    return count


class _Cdr:
    """Values one after the other, each aligned to its size."""

    def __init__(self) -> None:
        self.data = bytearray()

    def put(self, kinds: str, *values: Any) -> "_Cdr":
        for kind, value in zip(kinds, values, strict=True):
            self.data += bytes(-len(self.data) % struct.calcsize(kind)) + struct.pack("<" + kind, value)
        return self

    def text(self, text: str) -> "_Cdr":
        return self.bytes(text.encode() + b"\0")

    def bytes(self, data: bytes) -> "_Cdr":
        self.put("I", len(data)).data += data
        return self

    def header(self, stamp: int, frame: str) -> "_Cdr":
        return self.put("iI", *divmod(stamp, 10**9)).text(frame)


def _image(image: Image, stamp: int) -> _Cdr:
    pixels = np.ascontiguousarray(image.pixels, image.pixels.dtype.newbyteorder("<"))
    rows, cols = pixels.shape
    message = _Cdr().header(stamp, "camera").put("II", rows, cols)
    message.text("mono8" if pixels.itemsize == 1 else "mono16")
    return message.put("BI", 0, cols * pixels.itemsize).bytes(pixels.tobytes())


def _cloud(stamp: int, fields: dict[str, NDArray[Any]]) -> _Cdr:
    """Values (rows, cols) by the name of their field."""
    points = np.stack(list(fields.values()), axis=-1).astype("<f4")
    rows, cols, count = points.shape
    message = _Cdr().header(stamp, "mirror").put("III", rows, cols, count)
    for k, name in enumerate(fields):
        message.text(name).put("IBI", 4 * k, _FLOAT32, 1)
    message.put("BII", 0, 4 * count, 4 * count * cols).bytes(points.tobytes())
    return message.put("B", bool(np.isfinite(points).all()))


def _heights(reading: Reading, stamp: int) -> _Cdr:
    """NaN where there is none."""
    parts = {"x": reading.x, "y": reading.y, "z": reading.z, "sigma": reading.sigma}
    return _cloud(stamp, {name: np.where(reading.good, 1e-3 * part, np.nan) for name, part in parts.items()})


def _contacts(reading: Reading, stamp: int) -> _Cdr:
    """A point for each: centroid, depth as z; area in m^2, force in N, NaN without an elastic layer."""
    forces = {force.identity: (force.newton, force.sigma) for force in reading.forces}
    rows = []
    for one in reading.touches:
        lengths = [1e-3 * part for part in (one.x, one.y, one.depth, one.depth_sigma)]
        force = forces.get(one.identity, (np.nan, np.nan))
        rows.append((*lengths, 1e-6 * one.area, one.identity, *force))
    names = ("x", "y", "z", "depth_sigma", "area", "identity", "force", "force_sigma")
    columns = np.array(rows, np.float64).reshape(-1, len(names)).T
    return _cloud(stamp, dict(zip(names, columns[:, None], strict=True)))


def _wrench(reading: Reading, stamp: int) -> _Cdr:
    places = {touch.identity: touch for touch in reading.touches}
    pressed = [(force.newton, places[force.identity]) for force in reading.forces]
    force = sum(newton for newton, _ in pressed)
    about_x = sum(1e-3 * touch.y * newton for newton, touch in pressed)
    about_y = sum(-1e-3 * touch.x * newton for newton, touch in pressed)
    return _Cdr().header(stamp, "mirror").put("dddddd", 0, 0, force, about_x, about_y, 0)


if __name__ == "__main__":
    print(write_mcap(sys.argv[1], sys.argv[2]), "images")
