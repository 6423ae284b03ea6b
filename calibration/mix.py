"""Colours of a rig: how a display's channels mix in those of a camera, and the curve of each.

21 uniform pictures of 25 (`packed` of a ramp): a camera of linear levels sees dark + mix light(level), the
mean of lit pixels. Mix, dark and the light of each level shown are fitted by alternating least squares, sigma
by the scatter of the pictures. A display whose channels do not add leaves a misfit, by which the mix errs
more than by its scatter.
"""

from __future__ import annotations

from dataclasses import fields, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from optolever.errors import InputError
from optolever.files import plain
from optolever.patterns import STRIPES
from optolever.projector import ColourCapture, ColourResponse, quads, unmixed
from optolever.scene import rig_table, write_sections
from optolever.schema import built

__all__ = ["load_colours", "measure_colours", "store_colours"]

Floats = NDArray[np.float64]
#: Cells, half of what stripes lie aside.
_ASIDE = 1 / 6
#: Steps of the fit; error of the mix over the misfit of a display that does not add; span of a lit pixel over
#: the 95 % quantile; share of lit pixels that may clip; least span and largest misfit, shares of white.
_STEPS, _ADDING, _LIT, _CLIPPED, _DIM, _MOST = 100, 6.0, 0.25, 0.1, 0.05, 0.03


def measure_colours(capture: ColourCapture, mosaic: str | None = None) -> ColourResponse:
    """The response from a colour ramp; mosaic: of raw pictures. InputError where it is none, or clips."""
    packing, frames = capture.sequence.packing, capture.sequence.frames
    kinds = [] if packing is None else [frames[own[0]].kind for own in packing.exposures]
    if "uniform" not in kinds or {*kinds} - {"uniform", "phase"}:
        raise InputError("response --colour: needs pictures of optolever show --sequence ramp --colour ...")
    assert packing is not None
    uniform = np.array(kinds) == "uniform"
    levels = np.array([frame.level or 0 for frame in frames], np.float64)
    shown = levels[np.array(packing.exposures)[uniform]]
    white = float(2**capture.bits - 1)
    if mosaic is None and capture.images.ndim != 4:
        raise InputError("response --colour: pictures have one value per pixel; of a mosaic give --mosaic")
    planes = [
        (quads(image, mosaic) if mosaic else image.astype(np.float64)) / white
        for image in capture.images[uniform]
    ]
    dark, bright = planes[int(shown.sum(axis=1).argmin())], planes[int(shown.sum(axis=1).argmax())]
    span = (bright - dark).mean(axis=-1)
    lit = span > _LIT * np.percentile(span, 95)
    used = lit & (bright < 1).all(axis=-1)
    if span.max() < _DIM:
        raise InputError("response --colour: white is no brighter than black; is it the order of show?")
    if np.count_nonzero(used) < (1 - _CLIPPED) * np.count_nonzero(lit):
        raise InputError(
            "response --colour: white clips; expose less: all channels lit stay below 235 of 255"
        )
    seen = np.stack([plane[used].mean(axis=0) for plane in planes])
    found = fitted(shown, seen, mosaic)
    return replace(found, stripes=_stripes(capture, found)) if (~uniform).any() else found


def _stripes(capture: ColourCapture, response: ColourResponse) -> str | None:
    """Order of the display's stripes by the steps of a fringe along u that all channels show, which lies as
    far aside; None where that is none of those known."""
    sequence, packing = capture.sequence, capture.sequence.packing
    assert packing is not None
    steps = [own for own in packing.exposures if sequence.frames[own[0]].kind == "phase"]
    first, stated = sequence.frames[steps[0][0]], np.array(STRIPES[packing.stripes])
    turns = np.exp(1j * np.array([sequence.frames[own[0]].shift or 0.0 for own in steps]))
    frames = unmixed(capture.images, sequence, response, bits=capture.bits).frames
    waves = np.array([np.tensordot(turns, frames[[own[c] for own in steps]], 1) for c in range(3)])
    lit = np.abs(waves).min(axis=0) > _LIT * np.percentile(np.abs(waves[1]), 95)
    turned = np.angle((waves * waves[1].conj())[:, lit].sum(axis=1)) / (2 * np.pi)
    aside = stated - turned * (first.period_px or 1.0)
    off = {name: float(np.abs(aside - own)[::2].max()) for name, own in STRIPES.items() if name != "unknown"}
    best = min(off, key=lambda name: off[name])
    return best if off[best] < _ASIDE else None


def fitted(shown: Floats, seen: Floats, mosaic: str | None = None) -> ColourResponse:
    """From levels shown (K, 3) and mean shares of white seen (K, 3)."""
    knots = np.unique(shown)
    at = np.searchsorted(knots, shown)
    light = np.tile((knots - knots[0]) / np.ptp(knots), (3, 1))
    for _ in range(_STEPS):
        own = np.stack([light[c][at[:, c]] for c in range(3)], axis=1)
        design = np.column_stack([np.ones(len(shown)), own])
        fit = np.linalg.lstsq(design, seen, rcond=None)[0]
        dark, mix, rest = fit[0], fit[1:].T, seen - design @ fit
        if not np.linalg.cond(mix) < 1e3:
            raise InputError(
                "response --colour: the channels of display or camera are not apart; is it colour?"
            )
        back = (seen - dark) @ np.linalg.inv(mix).T
        for c in range(3):
            light[c] = np.array([back[at[:, c] == k, c].mean() for k in range(len(knots))])
            light[c] = (light[c] - light[c, 0]) / (light[c, -1] - light[c, 0])
    free = [np.eye(len(knots))[at[:, c]][:, 1:-1] for c in range(3)]  # the ends are 0 and 1
    jacobian = np.hstack(
        [np.kron(design, np.eye(3)), *(np.kron(f, mix[:, c : c + 1]) for c, f in enumerate(free))]
    )
    variance = float((rest**2).sum() / (rest.size - jacobian.shape[1]))
    scatter = np.sqrt(variance * np.diag(np.linalg.pinv(jacobian.T @ jacobian))[3:12].reshape(3, 3).T)
    misfit = variance**0.5
    if misfit > _MOST * float(mix.sum(axis=1).mean()):
        raise InputError(
            f"response --colour: pictures contradict each other by {100 * misfit:.2g} % of white, must be "
            f"{100 * _MOST:g} % at most: is it the order of show, a linear camera, white balance fixed?"
        )
    return ColourResponse(dark, mix, np.maximum(scatter, _ADDING * misfit), misfit, knots, light, mosaic)


def store_colours(rig: str | Path, found: ColourResponse) -> None:
    """Write the response into [colour] of the rig's TOML."""
    values = {field.name: getattr(found, field.name) for field in fields(found)}
    write_sections(rig, {"colour": {name: plain(one) for name, one in values.items() if one is not None}})


def load_colours(rig: str | Path) -> ColourResponse | None:
    """The response in [colour] of a rig's TOML; None where it has none. InputError names file and field."""
    section, where = rig_table(rig).get("colour"), f"{rig}: [colour]"
    if section is None:
        return None
    try:
        values = {name: np.array(one) if isinstance(one, list) else one for name, one in section.items()}
        found: ColourResponse = built(ColourResponse, values, "colour")
    except (InputError, AttributeError, ValueError) as error:
        raise InputError(f"{where}: {error}; measure it again: optolever response --colour") from error
    return found
