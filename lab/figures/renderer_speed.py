"""How many frames per second are drawn, read back and captured on the context at hand."""

import time
from collections.abc import Callable
from dataclasses import dataclass

from optolever.patterns import sequence
from optolever.projector import PatternRenderer, capture, chosen_renderer, context_info
from optolever.scene import Scene, Surface, resize

__all__ = ["RendererSpeed", "measure_renderer"]


@dataclass(frozen=True, slots=True)
class RendererSpeed:
    """Frames per second at rows x cols: drawn, drawn and read back, captured with noise.

    renderer: 'gl' or 'numpy' (then nothing is drawn: 0); context: of OpenGL, or NumPy.
    """

    rows: int
    cols: int
    renderer: str
    context: str
    drawn: float
    read_back: float
    captured: float


def measure_renderer(
    scene: Scene,
    surface: Surface,
    rows: int = 1080,
    cols: int = 1920,
    *,
    renderer: str = "auto",
    seconds: float = 1.0,
) -> RendererSpeed:
    """Draw gray+phase frames for `seconds` each way, and capture them once with noise of one level.

    The first capture, which compiles, is not counted.
    """
    chosen = chosen_renderer(renderer)
    drawn = read_back = 0.0
    shown = sequence("gray+phase", rows, cols)
    if chosen == "gl":
        with PatternRenderer(shown) as patterns:
            drawn = _rate(patterns.draw, len(shown), seconds, patterns.finish)
            read_back = _rate(lambda index: _read(patterns, index), len(shown), seconds, patterns.finish)
    small = resize(scene, 64, 64)
    capture(
        small,
        surface,
        sequence("gray+phase", small.pattern.rows, small.pattern.cols),
        renderer=chosen,
        noise=1.0,
    )
    sized = resize(scene, rows, cols)
    seen = sequence("gray+phase", sized.pattern.rows, sized.pattern.cols)
    start = time.perf_counter()
    capture(sized, surface, seen, renderer=chosen, noise=1.0)
    captured = len(seen) / (time.perf_counter() - start)
    name = str(context_info()) if chosen == "gl" else "NumPy"
    return RendererSpeed(rows, cols, chosen, name, drawn, read_back, captured)


def _read(patterns: PatternRenderer, index: int) -> None:
    patterns.frame(index)


def _rate(work: Callable[[int], None], count: int, seconds: float, finish: Callable[[], None]) -> float:
    work(0)
    finish()
    done, start = 0, time.perf_counter()
    while (passed := time.perf_counter() - start) < seconds:
        work(done % count)
        finish()
        done += 1
    return done / passed
