"""The virtual sensor in colour: every channel of the display a pattern of its own, seen by all three of the
camera."""

from dataclasses import replace

import numpy as np

from optolever.arrays import require_room
from optolever.errors import InputError
from optolever.patterns import STRIPES, Sequence
from optolever.records import Progress, silent
from optolever.scene import Scene, Sensor, Surface, resize
from optolever.schema import checked

from .colour_capture import ColourCapture
from .electronics import NOMINAL_SENSOR, FrameElectronics, flicker_factor
from .unmixing import ColourResponse
from .virtual import fitting_renderer, require_fit, strips

__all__ = ["capture_colour", "exact_response"]


@checked(scene=Scene, surface=Surface, sequence=Sequence)
def capture_colour(
    scene: Scene,
    surface: Surface,
    sequence: Sequence,
    *,
    renderer: str = "auto",
    noise: float = 0.0,
    seed: int = 0,
    bits: int | None = None,
    progress: Progress = silent,
) -> ColourCapture:
    """The pictures that a colour camera would take of a sequence in colour, in a still mirror of that shape.

    The light of each channel comes from its stripe of the scene's cells, wherever the sequence takes that to
    be. With sensor.mosaic pictures are raw, of twice the camera's rows and columns. Other arguments as of
    `capture`.
    """
    require_fit(scene, sequence)
    if sequence.packing is None:
        raise InputError("capture_colour: the sequence is in grey; patterns.packed puts it into colour")
    sensor = NOMINAL_SENSOR if scene.sensor is None else scene.sensor
    mix = np.asarray(NOMINAL_SENSOR.mix if sensor.mix is None else sensor.mix)
    depth = sensor.bits if bits is None else bits
    rows, cols = scene.camera.rows, scene.camera.cols
    if sensor.mosaic is not None:
        rows, cols = 2 * rows, 2 * cols
    viewed = replace(scene, camera=resize(scene, rows, cols).camera)
    chosen, count = fitting_renderer(renderer, viewed), len(sequence.packing.exposures)
    size = (count, rows, cols) if sensor.mosaic else (count, rows, cols, 3)
    require_room(f"{count} pictures of {rows}x{cols} pixels in colour", 2 * int(np.prod(size)))
    images = np.empty(size, np.uint8 if depth == 8 else np.uint16)
    times = np.arange(count, dtype=np.float64) * float(sensor.frame_s)
    planes = 1 if sensor.mosaic else 3
    electronics = [
        [
            FrameElectronics.of_frame(
                sensor, flicker_factor(sensor, time), float(np.hypot(noise, sensor.noise)), depth, seed,
                planes * k + plane,
            )
            for plane in range(planes)
        ]
        for k, time in enumerate(times.tolist())
    ]  # fmt: skip
    of_channels = [
        strips(_seen_at(viewed, channel), surface, sequence.channel(channel), chosen) for channel in range(3)
    ]
    for parts in zip(*of_channels, strict=True):
        start, stop = parts[0][:2]
        lights = [dict(lit) for _, _, lit in parts]
        for k in range(count):
            seen = np.tensordot(mix, np.stack([light[k] for light in lights]), 1).astype(np.float32)
            if sensor.mosaic:
                row, col = np.ogrid[start:stop, :cols]
                colour = np.array(["RGB".index(c) for c in sensor.mosaic])[2 * (row % 2) + col % 2]
                seen = np.take_along_axis(seen, colour[None], axis=0)
                electronics[k][0].expose(seen[0], images[k, start:stop])
            else:
                for plane in range(3):
                    electronics[k][plane].expose(seen[plane], images[k, start:stop, :, plane])
        progress("rows", stop, rows)
    exact = replace(scene, accuracy=None, covariance=None)
    return ColourCapture(images, sequence, exact, times, depth, sensor.mosaic or "RGB")


def exact_response(sensor: Sensor) -> ColourResponse:
    """The mix of a sensor's colours, without an error."""
    mix = sensor.exposure * np.asarray(NOMINAL_SENSOR.mix if sensor.mix is None else sensor.mix)
    ends = np.array([0.0, 255.0]), np.tile([0.0, 1.0], (3, 1))
    return ColourResponse(np.full(3, sensor.offset / 255), mix, 0 * mix, 0.0, *ends, sensor.mosaic)


def _seen_at(scene: Scene, channel: int) -> Scene:
    """The scene whose display is one channel: its curve, and its stripes, aside of the cells' centres."""
    pattern, display = scene.pattern, scene.display
    aside = STRIPES[pattern.stripes or "none"][channel]
    pattern = replace(pattern, origin=pattern.origin + aside * pattern.steps[0])
    return replace(scene, pattern=pattern, display=None if display is None else display.channel(channel))
