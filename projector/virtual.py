"""The virtual sensor: images of a scene with a dent while its pattern surface displays a sequence."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from optolever.arrays import require_room
from optolever.blocks import threads
from optolever.errors import InputError
from optolever.patterns import Sequence
from optolever.records import Progress, logged, silent
from optolever.scene import Scene, Surface
from optolever.schema import checked

from .capture import Capture, Image
from .context import NoContextError, context, context_info
from .electronics import NOMINAL_SENSOR, FrameElectronics, flicker_factor
from .groups import frame_groups
from .optics_gl import GLOptics
from .optics_numpy import NumpyOptics

__all__ = ["RENDERERS", "capture", "chosen_renderer", "fitting_renderer", "require_fit", "strips"]

#: Renderer of the light: OpenGL where there is a context, OpenGL, NumPy in float64; all take a pixel's
#: footprint for a parallelogram.
RENDERERS = ("auto", "gl", "numpy")

_STRIP = 1 << 19  # pixels of a frame whose light is in memory at a time

_LOUDEST = 1e9  # levels rms, as of a scene's sensor

Light = NDArray[np.float32]
Motion = Callable[[float], Surface]
_Strip = tuple[int, int, list[tuple[int, Light]]]  # first row, end, light (rows, W) by frame


class _Optics(Protocol):
    """A renderer of light: GLOptics, NumpyOptics."""

    def release(self) -> None: ...

    def render(self, start: int, stop: int) -> list[tuple[int, Light]]: ...


@checked(scene=Scene, surface=(Surface, Callable), sequence=Sequence)
def capture(
    scene: Scene,
    surface: Surface | Motion,
    sequence: Sequence,
    *,
    renderer: str = "auto",
    noise: float = 0.0,
    seed: int = 0,
    bits: int | None = None,
    samples: int = 8,
    progress: Progress = silent,
) -> Capture:
    """The images that a camera would take of `sequence` on the scene's pattern, in the mirror of that shape.

    surface: the mirror's shape, or a callable t (s) -> Surface of a moving one; frame i is taken at
    t = i frame_s, and with a shutter averaged over `samples` instants of it.
    renderer: 'gl', 'numpy' (float64, the reference), or 'auto', OpenGL where there is a context.
    noise: rms of Gaussian noise in 8-bit levels, added to the sensor's; seed: of all noise, same on
    every machine. bits: of the camera (default: the scene's sensor). A scene without a
    sensor has NOMINAL_SENSOR: level = 16 + 216.75 light, with photon noise of 30 electrons a level;
    WHITE_NOISE_SENSOR has the added noise alone.
    progress: called with the activity, the number of rows (frames, if it moves) done, and their total.
    """
    require_fit(scene, sequence)
    if not 0 <= noise < _LOUDEST:
        raise InputError(f"noise: {noise}, must be at least 0 levels and below {_LOUDEST:g}")
    if samples < 1:
        raise InputError(f"samples: {samples}, must be at least 1")
    sensor = NOMINAL_SENSOR if scene.sensor is None else scene.sensor
    chosen, depth = fitting_renderer(renderer, scene), sensor.bits if bits is None else bits
    size = (len(sequence), scene.camera.rows, scene.camera.cols)
    kind = np.uint8 if depth == 8 else np.uint16
    require_room(
        f"{size[0]} frames of {size[1]}x{size[2]} pixels", int(np.prod(size)) * np.dtype(kind).itemsize
    )
    frames = np.empty(size, kind)
    times = np.arange(len(sequence), dtype=np.float64) * float(sensor.frame_s)  # middles of the exposures
    electronics = [
        FrameElectronics.of_frame(
            sensor, flicker_factor(sensor, time), float(np.hypot(noise, sensor.noise)), depth, seed, index
        )
        for index, time in enumerate(times.tolist())
    ]
    with logged(f"capture {size[0]} frames of {size[1:]}"):
        if isinstance(surface, Surface):
            _expose(strips(scene, surface, sequence, chosen), electronics, frames, progress)
        else:
            count = samples if sensor.shutter_s > 0 else 1
            shifts = (sensor.shutter_s * ((np.arange(count) + 0.5) / count - 0.5)).tolist()
            for index, time in enumerate(times.tolist()):
                one = slice(index, index + 1)
                moved = [strips(scene, surface(time + shift), sequence[one], chosen) for shift in shifts]
                _expose(_averaged(moved), electronics[one], frames[one], silent)
                progress("frames", index + 1, size[0])
    exact = replace(scene, accuracy=None, covariance=None)  # a rendered scene has no errors
    return Capture(frames, sequence, exact, timestamps=times, bits=depth)


def chosen_renderer(renderer: str) -> str:
    """'gl' or 'numpy'; 'auto' is 'gl' where there is a context. InputError for 'gl' without one."""
    if renderer not in RENDERERS:
        raise InputError(f"renderer: {renderer!r}, must be one of {', '.join(RENDERERS)}")
    if renderer == "numpy":
        return renderer
    try:
        context()
    except NoContextError as error:
        if renderer == "gl":
            raise InputError(f"renderer: 'gl' is not possible here: {error}") from error
        return "numpy"
    return "gl"


def fitting_renderer(asked: str, scene: Scene) -> str:
    """The renderer, 'numpy' in place of a GL that was not asked for and cannot draw the scene."""
    if chosen_renderer(asked) == "numpy":
        return "numpy"
    widest, most = max(scene.camera.cols, scene.pattern.rows, scene.pattern.cols), context_info().max_texture
    fault = ""
    if scene.pattern.shape is not None:
        fault = "flat grids only, the scene's has a shape; take 'numpy'"
    elif widest > most:
        fault = f"at most {most} pixels in a row here, the scene has {widest}"
    if fault and asked == "gl":
        raise InputError(f"renderer: 'gl' draws {fault}")
    return "numpy" if fault else "gl"


def strips(scene: Scene, surface: Surface, sequence: Sequence, renderer: str) -> Iterator[_Strip]:
    """Light of a still mirror from the top down."""
    groups, rows = frame_groups(sequence, scene.display), scene.camera.rows
    step = min(rows, max(1, _STRIP // scene.camera.cols))
    optics: _Optics = (
        GLOptics(scene, groups, step, surface) if renderer == "gl" else NumpyOptics(scene, groups, surface)
    )
    try:
        for start in range(0, rows, step):
            stop = min(start + step, rows)
            yield start, stop, optics.render(start, stop)
    finally:
        optics.release()


def _averaged(instants: list[Iterator[_Strip]]) -> Iterator[_Strip]:
    """Mean light of one frame over instants."""
    for parts in zip(*instants, strict=True):
        start, stop, ((index, total),) = parts[0]
        for _, _, ((_, light),) in parts[1:]:
            total += light
        yield start, stop, [(index, total / np.float32(len(parts)))]


def _expose(
    strips: Iterable[_Strip], electronics: list[FrameElectronics], frames: Image, progress: Progress
) -> None:
    """The electronics make numbers of a strip while the next is rendered."""
    with ThreadPoolExecutor(threads()) as pool:
        working: list[Future[None]] = []
        for start, stop, lights in strips:
            _finish(working)
            working = [
                pool.submit(electronics[index].expose, light, frames[index, start:stop])
                for index, light in lights
            ]
            progress("rows", stop, frames.shape[1])
        _finish(working)


def _finish(working: list[Future[None]]) -> None:
    for future in working:
        future.result()


def require_fit(scene: Scene, sequence: Sequence) -> None:
    pattern = scene.pattern
    if (sequence.rows, sequence.cols) != (pattern.rows, pattern.cols):
        raise InputError(
            f"sequence: made for {sequence.rows}x{sequence.cols} pixels, "
            f"the pattern of scene {scene.name!r} has {pattern.rows}x{pattern.cols}"
        )
