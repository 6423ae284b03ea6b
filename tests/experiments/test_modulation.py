"""A capture that is too weak for its code: the notice names what decodes, by trying it."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from optolever.cli import run
from optolever.decode import Correspondence, decode
from optolever.experiments import code_that_decodes
from optolever.patterns import Sequence, sequence_from_text
from optolever.projector import Capture, capture
from optolever.scene import Scene, dent, load, resize


@pytest.fixture(scope="module")
def rig() -> Scene:
    return resize(load("prism48", exact=True), 90, 120)


def weak_capture(rig: Scene, text: str, reflectance: float, noise: float) -> tuple[Capture, Sequence]:
    """Frames of a mirror that reflects so little, 8 bits, noise in levels."""
    shown = sequence_from_text(text, rig.pattern.rows, rig.pattern.cols)
    ideal = capture(rig, dent("flat", rig), shown)
    light = reflectance * ideal.frames + noise * np.random.default_rng(3).standard_normal(ideal.frames.shape)
    return replace(ideal, frames=np.clip(np.rint(3 + light), 0, 255).astype(np.uint8)), shown


def decoded(rig: Scene, text: str, reflectance: float, noise: float) -> Correspondence:
    taken, shown = weak_capture(rig, text, reflectance, noise)
    return decode(taken.frames, shown)


@pytest.mark.daily(1)
@pytest.mark.parametrize(
    ("text", "reflectance", "noise"),
    [
        ("gray+phase", 0.07, 2.0),
        ("gray+phase", 0.03, 1.0),
        ("phase", 0.05, 2.0),
        ("micro-phase", 0.07, 2.0),
    ],
)
def test_a_refused_capture_names_what_would_decode(
    rig: Scene,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    text: str,
    reflectance: float,
    noise: float,
) -> None:
    """A mirror of a few per cent, all of whose pixels are refused: both cures of the notice are tried, and
    modulation over noise is that of the frames."""
    taken, shown = weak_capture(rig, text, reflectance, noise)
    taken.save(tmp_path / "weak")
    assert decode(taken.frames, shown).good.mean() < 0.05
    assert run(["decode", str(tmp_path / "weak"), "--out", str(tmp_path / "c.npz")]) == 0
    assert "The pattern is too weak for" in capsys.readouterr().err
    (notice,) = (one for one in Correspondence.load(tmp_path / "c.npz").notices if "too weak" in one.name)
    found = re.search(r"expose ([\d.]+) times as long, or show --sequence (\S+) ", notice.cure)
    ratio = re.search(r"is ([\d.]+) times the noise", notice.name)
    assert found is not None
    assert ratio is not None
    bright = decoded(rig, text, 1.0, 1.0).amplitude
    assert bright is not None
    assert 0.75 < float(ratio[1]) / (reflectance * np.median(bright) / noise) < 1.25
    assert decoded(rig, found[2], reflectance, noise).good.mean() > 0.9
    assert decoded(rig, text, float(found[1]) * reflectance, noise).good.mean() > 0.85


def test_a_capture_that_decodes_is_told_no_other_code(rig: Scene) -> None:
    """Nor one that is refused as two frames have changed places, whatever its modulation."""
    taken, shown = weak_capture(rig, "phase:steps=3", 1.0, 1.0)
    assert code_that_decodes(decode(taken.frames, shown), shown) is None
    swapped = taken.frames[[1, 0, *range(2, len(shown))]]
    assert code_that_decodes(decode(swapped, shown), shown) is None
