"""`optolever camera devices`: cameras and monitors, each with its address."""

from dataclasses import asdict

import optolever as ol
from optolever import InputError

from .arguments import program
from .options import Json
from .printing import grid, print_notices, table, write_json

SAMPLE = """
$ optolever camera devices
Cameras
camera                                      model         serial  formats    note
v4l2:/dev/v4l/by-id/usb-Maker_Cam_123-...   Cam: Cam      123     GREY YUYV
gige:192.168.0.12                           acA1920-40gm  22781
Monitors
  0  DELL U2412M:YMYH1234 (1200 x 1920, 60 Hz, 324 x 518 mm, 8 bits)
"""


@program("devices", SAMPLE)
def command(json_path: Json = None) -> None:
    """List cameras and monitors with the words that choose them.

    A camera is chosen by address or serial:NUMBER, a monitor by model and serial (or by its output), never
    by a number that changes when something is plugged in. Besides: camera=folder:DIR, replay:DIR, virtual;
    display=window.
    """
    from optolever.camera.cameras import find_cameras

    cameras, silent = find_cameras()
    try:
        shown = ol.projector.monitors()
    except InputError as error:
        shown, silent = [], silent | {"monitors": str(error)}
    monitors = [asdict(one) | {"display": one.address, "faults": one.faults()} for one in shown]
    found = {"cameras": [asdict(one) for one in cameras], "not_looked_for": silent, "monitors": monitors}
    write_json(json_path, found)
    rows = [[one.address, one.model, one.serial, " ".join(one.formats[:4]), one.note] for one in cameras]
    grid("Cameras", ("camera", "model", "serial", "formats", "note"), rows or [["none"]])
    print_notices(silent.values())
    print_monitors(shown)


def print_monitors(found: "list[ol.projector.Monitor]") -> None:
    """Number and name of each, and notices about settings that spoil patterns."""
    table("Monitors", {str(one.index): str(one) for one in found} or {"none": ""})
    print_notices(fault for one in found for fault in one.faults())
