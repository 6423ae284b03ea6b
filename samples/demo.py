"""The full chain on a virtual sensor: scene, dent -> frames -> correspondence -> height, against truth."""

from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from optolever.decode import Correspondence, Flag, decode
from optolever.patterns import Sequence, sequence_from_text
from optolever.projector import Capture, capture, chosen_renderer
from optolever.reconstruct import Contact, HeightMap, reconstruct
from optolever.records import Progress, silent
from optolever.scene import Scene, Trace, dent_from_text, load, resize, trace
from optolever.timing import Stages, peak_bytes

from .measurement import Measurement, Study
from .metrics import height_metrics


@dataclass(frozen=True)
class DemoResult:
    """Results of a run: the records of the chain, metrics, settings (plain values), memory, and the seconds
    of each stage (trace, capture, decode, reconstruct, total, and report, once it is written).

    metrics: see `metrics.height_metrics`. contacts: of the report.
    """

    scene: Scene
    sequence: Sequence
    capture: Capture
    truth: Trace
    correspondence: Correspondence
    height: HeightMap
    metrics: dict[str, float]
    seconds: dict[str, float]
    peak_bytes: int
    settings: dict[str, Any]
    contacts: tuple[Contact, ...] = ()

    def to_dict(self) -> dict[str, Any]:
        """The numbers as plain values: metrics, seconds, peak_bytes, settings."""
        return {
            **self.metrics,
            "seconds": self.seconds,
            "peak_bytes": self.peak_bytes,
            "settings": self.settings,
            "contacts": [contact.to_dict() for contact in self.contacts],
            "notices": [asdict(notice) for notice in self.height.notices],
        }

    def with_report(self, seconds: float) -> "DemoResult":
        """The run with `seconds` as the time of its report."""
        stages = {name: each for name, each in self.seconds.items() if name not in ("report", "total")}
        stages["report"] = seconds
        return replace(self, seconds=stages | {"total": sum(stages.values())}, peak_bytes=peak_bytes())


def compile_heights() -> None:
    """Compile the kernels of heights and their page by a small map, while another process has none yet."""
    scene = resize(load("prism48", exact=True), 48, 64)
    truth = trace(scene, dent_from_text("gaussian:peak=0.1", scene))
    u, v = (place.astype(np.float32) for place in (truth.u, truth.v))
    sigma, flags = np.full_like(u, 0.01), np.where(truth.visible, 0, Flag.OFF_PATTERN).astype(np.uint16)
    where = Correspondence(u, v, sigma, sigma, flags)
    Study.of(Measurement(reconstruct(where, scene), where, scene=scene))


def run_demo(
    scene: Scene | str | Path = "paper-simulation",
    dent: str | None = None,
    sequence: str = "gray+phase",
    *,
    noise: float = 1.0,
    seed: int = 0,
    size: tuple[int, int] | None = None,
    renderer: str = "auto",
    progress: Progress = silent,
) -> DemoResult:
    """Simulate the frames of a scene's dented mirror, decode, reconstruct, and compare with the truth.

    dent: None is the scene's dent, else a raised cosine. noise: standard deviation of added Gaussian noise,
    8-bit levels. renderer: auto, gl or numpy. InputError for unknown names.
    """
    known = scene if isinstance(scene, Scene) else load(scene, exact=True)
    known = known if size is None else resize(known, *size)
    drawn_by, pressed = chosen_renderer(renderer), dent or known.dent or "raised-cosine"
    pattern = sequence_from_text(sequence, known.pattern.rows, known.pattern.cols)
    stages = Stages(4, progress)
    with stages.stage("trace"):
        surface = dent_from_text(pressed, known)
        truth = trace(known, surface)
    with stages.stage("capture"):
        taken = capture(known, surface, pattern, renderer=drawn_by, noise=noise, seed=seed)
    with stages.stage("decode"):
        correspondence = decode(taken.frames, pattern)
    with stages.stage("reconstruct"):
        height = reconstruct(correspondence, known)
    settings = {
        "scene": known.name, "size": [known.camera.rows, known.camera.cols], "blur_px": known.pattern.blur_px,
        "dent": pressed, "sequence": sequence, "frames": len(pattern), "noise": noise, "seed": seed,
        "renderer": drawn_by, "method": height.diagnostics.method, "anchor": None,
    }  # fmt: skip
    metrics = height_metrics(truth, correspondence, height)
    found = (correspondence, height, metrics, stages.seconds, peak_bytes(), settings)
    return DemoResult(known, pattern, taken, truth, *found)
