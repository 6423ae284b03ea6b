"""python examples/mcap.py RECORDING FILE.mcap: a recording for ROS 2 tools (needs the package mcap).

Images on /camera, swaps and refused images on /log.

Messages are `ros2msg`: sensor_msgs/msg/Image and std_msgs/msg/String (JSON) in CDR, little endian. Times are
those of the recording, nanoseconds of CLOCK_MONOTONIC: the log's is the image's stamp, the other its arrival.
"""

import json
import struct
import sys
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from mcap.writer import Writer

from optolever.files import atomic_file
from optolever.projector import Image, Recording, Shown

__all__ = ["write_mcap"]

_STRING = "string data\n"
_IMAGE = f"""std_msgs/Header header
uint32 height
uint32 width
string encoding
uint8 is_bigendian
uint32 step
uint8[] data
{"=" * 80}
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
{"=" * 80}
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
"""
_CDR = b"\0\1\0\0"  # encapsulation: plain, little endian


def write_mcap(recording: Recording, path: str | Path) -> int:
    """Write all complete images and all events; the number of images."""
    count = 0
    with atomic_file(Path(path)) as temporary, temporary.open("wb") as file:
        writer: Any = Writer(file)  # in part without types
        writer.start("ros2", "optolever")
        channels = [
            writer.register_channel(topic, "cdr", writer.register_schema(name, "ros2msg", text.encode()))
            for topic, name, text in (
                ("/camera", "sensor_msgs/msg/Image", _IMAGE),
                ("/log", "std_msgs/msg/String", _STRING),
            )
        ]

        def log(values: dict[str, Any], time: int) -> None:
            writer.add_message(channels[1], time, _CDR + _text(json.dumps(values)), time)

        log(recording.about, 0)
        for event in recording:
            if isinstance(event, Shown):
                log({"event": "shown", **asdict(event)}, _nanoseconds(event.swapped_s))
                continue
            image, stamp = event.image, _nanoseconds(event.stamp_s)
            if not image.complete:
                log({"event": "incomplete", "id": image.id, "why": image.why}, stamp)
                continue
            arrived, number = _nanoseconds(image.arrived_s), image.id or count
            writer.add_message(channels[0], stamp, _image(image, stamp), arrived, number % 2**32)
            count += 1
        writer.finish()
    return count


def _image(image: Image, stamp: int) -> bytes:
    """sensor_msgs/msg/Image in CDR."""
    pixels = np.ascontiguousarray(image.pixels, image.pixels.dtype.newbyteorder("<"))
    rows, cols = pixels.shape
    head = struct.pack("<iI", *divmod(stamp, 10**9)) + _text("camera")
    size = struct.pack("<II", rows, cols) + _text("mono8" if pixels.itemsize == 1 else "mono16") + b"\0"
    end = struct.pack("<II", cols * pixels.itemsize, pixels.nbytes)
    return _CDR + _aligned(_aligned(head) + size) + end + pixels.tobytes()


def _text(text: str) -> bytes:
    data = text.encode() + b"\0"
    return struct.pack("<I", len(data)) + data


def _aligned(data: bytes) -> bytes:
    return data + bytes(-len(data) % 4)


def _nanoseconds(seconds: float) -> int:
    return round(1e9 * seconds)


if __name__ == "__main__":
    print(write_mcap(Recording(sys.argv[1]), sys.argv[2]), "images")
