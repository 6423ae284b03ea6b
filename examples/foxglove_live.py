"""python examples/foxglove_live.py RIG.toml PORT [KEY=VALUE ...]: readings of a rig, live in Foxglove (needs
the package foxglove-sdk).

A JSON message a reading on /reading, as `live --json-lines` prints it, at the wall clock's time: contacts
with place and depth (mm), force (N), trust. KEY=VALUE: changes of [devices], such as camera=virtual.
Open ws://127.0.0.1:PORT there; port 0 is any free one.
"""

import sys

import foxglove

from optolever import live
from optolever.files import plain

__all__ = ["serve"]


def serve(rig: str, port: int, changes: list[str]) -> None:
    """Until it is interrupted."""
    with live.open(rig, changes=changes) as readings:
        server = foxglove.start_server(name="optolever", port=port)
        print(f"ws://127.0.0.1:{server.port}", flush=True)
        channel = foxglove.Channel("/reading", message_encoding="json", schema={"type": "object"})
        try:
            for followed in readings.followed():
                channel.log(plain(followed.to_dict()), log_time=round(1e9 * (followed.wall or 0.0)))
        finally:
            server.stop()


if __name__ == "__main__":
    serve(sys.argv[1], int(sys.argv[2]), sys.argv[3:])
