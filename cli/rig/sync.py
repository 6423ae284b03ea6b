"""`optolever camera sync`: latency, settling and shutter of a rig's display and camera, into its [sync].

$ optolever camera sync --rig rig.toml
Synchronisation in rig.toml
  latency     38.20 ± 0.40 ms
  jitter      0.25 ms at most
  rise, fall  4.9 ms, 5.2 ms
  shutter     16.02 ms
  wait        75.1 ms after a swap
  exposure    16.67 ms, 1 refreshes
  flicker     0.1 % of white
  residual    0.2 % of white less black
"""

from dataclasses import replace
from pathlib import Path

import optolever as ol
from optolever.quantities import quantity

from ..arguments import program
from ..options import Json, Seed
from ..printing import number, print_notices, table, write_json
from .opened import Changes, OpenedRig, levels_of, opened


@program("sync", __doc__)
def command(
    rig: OpenedRig,
    changes: Changes = (),
    seed: Seed = 0,
    json_path: Json = None,
) -> None:
    """Measure the delay from a pattern to its settled image.

    Switches the full display between black and white for some seconds and records it with the camera.
    RIG.toml gets [devices] as used and [sync]; capture then waits for the measured time only.
    """
    kept, timing = synchronised(rig, ol.camera.devices_of(rig, changes), seed)
    with ol.files.together():
        ol.scene.write_sections(rig, {"devices": kept.table(), "sync": timing.to_table()})
        write_json(json_path, timing.to_table() | {"ready_s": timing.ready_s()})
    print_notices(ol.camera.sync_notices(timing))
    sigma = timing.sigma_s or {}
    refreshes = "" if timing.refresh_s is None else f", {timing.exposure_s / timing.refresh_s:.3g} refreshes"
    rows = {
        "latency": quantity(1e3 * timing.latency_s, "ms", 1e3 * sigma.get("latency", 0.0)),
        "jitter": number(1e3 * timing.jitter_s, "ms at most"),
        "rise, fall": f"{1e3 * timing.rise_s:.2f} ms, {1e3 * timing.fall_s:.2f} ms",
        "shutter": number(1e3 * timing.shutter_s, "ms"),
        "wait": number(1e3 * timing.ready_s(), "ms after a swap"),
        "exposure": number(1e3 * timing.exposure_s, "ms") + refreshes,
        "flicker": number(100 * timing.flicker, "% of white"),
        "residual": number(100 * timing.misfit, "% of white less black"),
    }
    table(f"Synchronisation in {rig}", rows)


def synchronised(
    rig: Path, devices: "ol.camera.Devices", seed: int = 0
) -> "tuple[ol.camera.Devices, ol.camera.Timing]":
    """[devices] as used, and [sync]."""
    with opened(rig, devices, levels_of(rig, "black", "white")) as now:
        found, _ = ol.camera.synchronise(
            now.display, now.camera, now.accepted,
            time=now.time, clock=now.clock, seed=seed, triggered=now.triggered,
        )  # fmt: skip
    timing = replace(found, camera=devices.camera, display=devices.display)
    return replace(devices, focus=now.accepted.focus), timing
