"""Captures whose modulation is too weak to be decoded: the exposure or the code that would decode, found by
the decoder on simulated patches. White Gaussian noise only, pixels without a footprint.
"""

import numpy as np

from optolever.decode import Correspondence, decode
from optolever.notices import Notice
from optolever.patterns import BINARY_CODES, Sequence, sequence_from_text

from .arrays import Floats, Mask

#: Camera of the trials, pixels: a patch each at the start, the middle and the end of the surface.
_PATCHES, _PATCH = 3, (32, 128)
#: Maximum share of good pixels in a failed capture, and minimum for a working code, among illuminated pixels.
_REFUSED, _DECODED = 0.1, 0.9
#: Codes for weak modulation, by number of frames.
_PATIENT = ("phase", "phase:steps=8", "phase:steps=16")
#: Modulation over noise of the trials for comparison with a failed capture, and factors on the exposure.
_RATIOS = np.geomspace(1, 8, 4)
_EXPOSURES = (1.5, 2, 3, 4, 6)
_AS_ROUGH = 0.5  # of the amplitude's second differences by noise
_MARGIN = 0.9  # safety factor on the modulation, for cures
#: Offset and amplitude of the trials, steps of the camera: only the amplitude over the noise matters.
_LEVELS = 2000.0, 1000.0


def code_that_decodes(found: Correspondence, sequence: Sequence) -> Notice | None:
    """The notice of a capture whose modulation is too weak for its sequence: the exposure or the code that
    would decode. None where enough pixels are good, or where noise is not the cause.

    Modulation over noise is that of a simulated capture of the same sequence with the same median sigma of
    the illuminated pixels, provided that the amplitudes of adjacent pixels differ as much. Codes are then
    tried by simulation and decoding.
    """
    if found.amplitude is None or not (found.amplitude > 0).any():
        return None
    lit = found.amplitude > 0.5 * np.nanpercentile(found.amplitude, 95)
    share = float(found.good[lit].mean())
    if share > _REFUSED:
        return None
    ratio = _modulation(_median_sigma(found, lit), sequence)
    if ratio is None:
        return None
    similar = _trial(sequence, ratio)
    if similar.good.mean() > _REFUSED or _roughness(found, lit) < _AS_ROUGH * _roughness(similar):
        return None
    longer = next((by for by in _EXPOSURES if _decodes(sequence, by * _MARGIN * ratio)), None)
    cure = f"expose {'more than ' if longer is None else ''}{longer or _EXPOSURES[-1]:g} times as long"
    for text in _PATIENT:
        code = sequence_from_text(text, sequence.rows, sequence.cols)
        if _decodes(code, _MARGIN * ratio):
            cure += f", or show --sequence {text} ({len(code)} frames)"
            break
    name = (
        f"The pattern is too weak for {sequence.name}: its modulation is {ratio:.2g} times the noise of a "
        "frame; share of good pixels"
    )
    return Notice(name, share, _DECODED, cure)


def _modulation(stated: float, sequence: Sequence) -> float | None:
    """Amplitude over a frame's noise at which the decoder states this median sigma (px); None: unknown."""
    trials = [(_median_sigma(_trial(sequence, ratio)), ratio) for ratio in _RATIOS]
    known = [(sigma, ratio) for sigma, ratio in trials if np.isfinite(sigma)]
    if not np.isfinite(stated) or len(known) < 2:
        return None
    sigma, ratios = np.array(sorted(known)).T
    return float(np.exp(np.interp(np.log(stated), np.log(sigma), np.log(ratios))))


def _median_sigma(found: Correspondence, where: Mask | None = None) -> float:
    """Median over pixels of the smaller sigma of both axes, px."""
    sigma = np.minimum(found.sigma_u, found.sigma_v)
    return float(np.median(sigma if where is None else sigma[where]))


def _roughness(found: Correspondence, lit: Mask | None = None) -> float:
    """Median second difference of the amplitude along rows over the median amplitude, a measure of noise."""
    assert found.amplitude is not None
    bend = np.abs(np.diff(found.amplitude, 2, axis=1))
    known = np.ones(found.flags.shape, np.bool_) if lit is None else lit
    inside = known[:, :-2] & known[:, 1:-1] & known[:, 2:]
    return float(np.median(bend[inside]) / np.median(found.amplitude[known])) if inside.any() else 0.0


def _decodes(sequence: Sequence, ratio: float) -> bool:
    return bool(_trial(sequence, ratio).good.mean() > _DECODED)


def _trial(sequence: Sequence, ratio: float) -> Correspondence:
    """Simulated patches with this amplitude over noise, decoded."""
    places, rng = _places(sequence), np.random.default_rng(0)
    offset, amplitude = _LEVELS
    frames = np.empty((len(sequence), *places[0].shape), np.uint16)
    for frame, levels in zip(
        frames, (_levels(sequence, k, places) for k in range(len(sequence))), strict=True
    ):
        noise = amplitude / ratio * rng.standard_normal(levels.shape)
        frame[:] = np.rint(offset + amplitude * (levels / 127.5 - 1) + noise).clip(0)
    return decode(frames, sequence, on_cells=False)


def _levels(sequence: Sequence, index: int, places: tuple[Floats, Floats]) -> Floats:
    """Grey levels of a frame at places (u, v): of the cell for bits, else between the cells."""
    frame, axis = sequence.frames[index], int(sequence.frames[index].axis == "v")
    table = frame.tables(sequence.rows, sequence.cols)[axis].astype(np.float64)
    at = np.rint(places[axis]) if frame.kind in BINARY_CODES else places[axis]
    return np.interp(at, np.arange(len(table)), table)


def _places(sequence: Sequence) -> tuple[Floats, Floats]:
    """Coordinates (u, v) of the trials' pixels: patches one below the other, about one cell per pixel."""
    rows, cols = (min(n, size - 4) for n, size in zip(_PATCH, (sequence.rows, sequence.cols), strict=True))
    row, col = np.mgrid[:rows, :cols].astype(np.float64)
    u = 0.93 * (col - cols / 2) + 2 * np.sin(row / 19)
    v = 0.95 * (row - rows / 2) + 2 * np.cos(col / 23)
    share = np.linspace(-0.5, 0.5, _PATCHES)
    room = max(sequence.cols - cols - 4, 0), max(sequence.rows - rows - 4, 0)
    return (
        np.concatenate([u + sequence.cols / 2 + part * room[0] for part in share]),
        np.concatenate([v + sequence.rows / 2 + part * room[1] for part in share]),
    )
