"""The virtual sensor: images of a scene with a dent while its pattern surface displays a sequence."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import replace
from types import TracebackType
from typing import Any, Protocol, Self

import numpy as np
from numpy.typing import NDArray

from optolever.blocks import threads
from optolever.errors import InputError
from optolever.memory import require_room
from optolever.patterns import Sequence
from optolever.records import Progress, logged, silent
from optolever.scene import Scene, Surface

from .capture import Capture, Image
from .context import NoContextError, context, context_info
from .electronics import NOMINAL_SENSOR, FrameElectronics, flicker_factor
from .groups import frame_groups
from .optics_gl import GLOptics
from .optics_numpy import NumpyOptics

__all__ = ["RENDERERS", "VirtualSensor", "capture", "chosen_renderer"]

#: Renderer of the light: OpenGL where there is a context, OpenGL, NumPy in float64; all take a pixel's
#: footprint for a parallelogram.
RENDERERS = ("auto", "gl", "numpy")

_STRIP = 1 << 19  # pixels of a frame whose light is in memory at a time

_LOUDEST = 1e9  # levels rms, as of a scene's sensor

Light = NDArray[np.float32]
Motion = Callable[[float], Surface]


class _Optics(Protocol):
    """A renderer of light: GLOptics, NumpyOptics."""

    def load(self, surface: Surface) -> Any: ...

    def unload(self, surface: Any) -> None: ...

    def release(self) -> None: ...

    def render(
        self, surface: Any, start: int, stop: int, frame: int | None = None
    ) -> list[tuple[int, Light]]: ...


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
    """The camera's images of `sequence`; see VirtualSensor for the parameters.

    progress: called with the activity, the number of rows (frames, if it moves) done, and their total.
    """
    with (
        VirtualSensor(
            scene,
            surface,
            sequence,
            renderer=renderer,
            noise=noise,
            seed=seed,
            bits=bits,
            samples=samples,
        ) as sensor,
        logged(f"capture {len(sequence)} frames of {sensor.shape}"),
    ):
        return sensor.capture(progress)


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


def _fitting(chosen: str, asked: str, scene: Scene) -> str:
    """'numpy' in place of a GL that was not asked for and has no textures so wide; else as chosen."""
    if chosen != "gl":
        return chosen
    if scene.pattern.shape is not None:
        if asked == "gl":
            raise InputError("renderer: 'gl' draws flat grids only, the scene's has a shape; take 'numpy'")
        return "numpy"
    widest = max(scene.camera.cols, scene.pattern.rows, scene.pattern.cols)
    most = context_info().max_texture
    if widest > most and asked == "gl":
        raise InputError(f"renderer: 'gl' draws at most {most} pixels in a row here, the scene has {widest}")
    return "numpy" if widest > most else chosen


class VirtualSensor:
    """A camera that does not exist: its frames are rendered. A context manager.

    surface: the mirror's shape, or a callable t (s) -> Surface of a moving one; frame i is taken at t = i
    frame_s,
        and with a shutter averaged over `samples` instants of it.
    renderer: 'gl', 'numpy' (float64, the reference), or 'auto', OpenGL where there is a context.
    noise: rms of Gaussian noise in 8-bit levels, added to the sensor's; seed: of all noise, same on
    every machine. bits: of the camera (default: the scene's sensor). A scene without a
    sensor has NOMINAL_SENSOR: level = 16 + 216.75 light, with photon noise of 30 electrons a level;
    WHITE_NOISE_SENSOR has the added noise alone.
    """

    def __init__(
        self,
        scene: Scene,
        surface: Surface | Motion,
        sequence: Sequence,
        *,
        renderer: str = "auto",
        noise: float = 0.0,
        seed: int = 0,
        bits: int | None = None,
        samples: int = 8,
    ) -> None:
        _require_fit(scene, sequence)
        if not 0 <= noise < _LOUDEST:
            raise InputError(f"noise: {noise}, must be at least 0 levels and below {_LOUDEST:g}")
        if samples < 1:
            raise InputError(f"samples: {samples}, must be at least 1")
        self._scene, self._surface, self._seed, self._samples = scene, surface, seed, samples
        self._sensor = NOMINAL_SENSOR if scene.sensor is None else scene.sensor
        self._sequence = sequence
        self._noise = float(np.hypot(noise, self._sensor.noise))
        self._bits = self._sensor.bits if bits is None else bits
        self._strip = min(scene.camera.rows, max(1, _STRIP // scene.camera.cols))
        self._optics: _Optics = self._make_optics(_fitting(chosen_renderer(renderer), renderer, scene))
        self._still = self._optics.load(surface) if isinstance(surface, Surface) else None

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.release()

    @property
    def shape(self) -> tuple[int, int]:
        """(rows, cols) of the camera."""
        return self._scene.camera.rows, self._scene.camera.cols

    @property
    def bits(self) -> int:
        """Of the camera."""
        return self._bits

    @property
    def sequence(self) -> Sequence:
        """The displayed sequence."""
        return self._sequence

    def time(self, index: int) -> float:
        """Middle of the exposure of frame `index`, s."""
        return index * self._sensor.frame_s

    def grab(self, index: int) -> Image:
        """The image (H, W) taken while frame `index` is on show."""
        out = self._blank(1)
        self._expose({index: out[0]}, self._instants(index), index)
        image: Image = out[0]
        return image

    def capture(self, progress: Progress = silent) -> Capture:
        """All frames. A still mirror is traced once for all of them."""
        frames = self._blank(len(self._sequence))
        if self._still is not None:
            self._expose(dict(enumerate(frames)), [], None, progress)
        else:
            for index, frame in enumerate(frames):
                self._expose({index: frame}, self._instants(index), index)
                progress("frames", index + 1, len(frames))
        times = np.array([self.time(index) for index in range(len(frames))])
        exact = replace(self._scene, accuracy=None, covariance=None)  # a rendered scene has no errors
        return Capture(frames, self._sequence, exact, timestamps=times, bits=self._bits)

    def release(self) -> None:
        """Free the renderer's memory."""
        if self._still is not None:
            self._optics.unload(self._still)
        self._optics.release()

    def _make_optics(self, renderer: str) -> _Optics:
        groups = frame_groups(self._sequence, self._scene.display)
        if renderer == "gl":
            return GLOptics(self._scene, groups, self._strip)
        return NumpyOptics(self._scene, groups)

    def _blank(self, count: int) -> NDArray[Any]:
        kind = np.uint8 if self._bits == 8 else np.uint16
        rows, cols = self.shape
        require_room(f"{count} frames of {rows}x{cols} pixels", count * rows * cols * np.dtype(kind).itemsize)
        return np.empty((count, rows, cols), kind)

    def _instants(self, index: int) -> list[float]:
        """The times at which a moving mirror is rendered for a frame."""
        count = self._samples if self._sensor.shutter_s > 0 else 1
        shifts = (np.arange(count) + 0.5) / count - 0.5
        return [self.time(index) + self._sensor.shutter_s * float(shift) for shift in shifts]

    def _electronics(self, index: int) -> FrameElectronics:
        gain = flicker_factor(self._sensor, self.time(index))
        return FrameElectronics.of_frame(self._sensor, gain, self._noise, self._bits, self._seed, index)

    def _expose(
        self,
        frames: Mapping[int, Image],
        instants: list[float],
        frame: int | None,
        progress: Progress = silent,
    ) -> None:
        """Render strip by strip; meanwhile the electronics make numbers of the strip before."""
        electronics = {index: self._electronics(index) for index in frames}
        surfaces = [self._still] if self._still is not None else self._load_moving(instants)
        try:
            with ThreadPoolExecutor(threads()) as pool:
                working: list[Future[None]] = []
                for start, stop, lights in self._strips(surfaces, frame):
                    _finish(working)
                    working = [
                        pool.submit(electronics[index].expose, light, frames[index][start:stop])
                        for index, light in lights
                    ]
                    progress("rows", stop, self.shape[0])
                _finish(working)
        finally:
            for surface in surfaces if self._still is None else []:
                self._optics.unload(surface)

    def _load_moving(self, instants: list[float]) -> list[Any]:
        assert callable(self._surface)
        return [self._optics.load(self._surface(time)) for time in instants]

    def _strips(
        self, surfaces: list[Any], frame: int | None
    ) -> Iterator[tuple[int, int, list[tuple[int, Light]]]]:
        """(start, stop, light of the frames averaged over the surfaces) from the top down."""
        rows = self.shape[0]
        for start in range(0, rows, self._strip):
            stop = min(start + self._strip, rows)
            lights = self._optics.render(surfaces[0], start, stop, frame)
            for surface in surfaces[1:]:
                for (_, total), (_, light) in zip(
                    lights, self._optics.render(surface, start, stop, frame), strict=True
                ):
                    total += light
            if len(surfaces) > 1:
                for _, total in lights:
                    total /= np.float32(len(surfaces))
            yield start, stop, lights


def _finish(working: list[Future[None]]) -> None:
    for future in working:
        future.result()


def _require_fit(scene: Scene, sequence: Sequence) -> None:
    pattern = scene.pattern
    if (sequence.rows, sequence.cols) != (pattern.rows, pattern.cols):
        raise InputError(
            f"sequence: made for {sequence.rows}x{sequence.cols} pixels, "
            f"the pattern of scene {scene.name!r} has {pattern.rows}x{pattern.cols}"
        )
