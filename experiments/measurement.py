"""A measurement, and what its page computes of it: slopes, the form and the deviation from it, dents."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from optolever.decode import Correspondence
from optolever.errors import InputError
from optolever.metrology import FormFit, ZernikeFit, fit_form, fit_zernike
from optolever.projector import Capture
from optolever.reconstruct import (
    Contact,
    CurvatureMap,
    HeightMap,
    SlopeMap,
    contacts,
    curvature_map,
    slope_map,
)
from optolever.scene import PinholeCamera, Scene, Trace

__all__ = ["Measurement", "Study"]

ZERNIKE = 6  # radial order


@dataclass(frozen=True, eq=False)
class Measurement:
    """What a page is about: the height map; as far as they are known the correspondence, capture and scene
    behind it, and the truth.

    source: file of the map; rig: file of the scene; simulated: whether no camera took the frames. form: to be
    taken off (`metrology.fit_form`); '': none; None: a sphere where the scene is a mirror in open air. less:
    maps of the same rig by name, for differences. saved: files of FILES beside the page that are there.
    """

    height: HeightMap
    correspondence: Correspondence | None = None
    capture: Capture | None = None
    scene: Scene | None = None
    truth: Trace | None = None
    source: str = ""
    rig: str = ""
    simulated: bool = False
    form: str | None = None
    less: Mapping[str, HeightMap] = field(default_factory=dict)
    saved: tuple[str, ...] = ()

    @property
    def name(self) -> str:
        """Of the map, in differences."""
        return Path(self.source).stem or "this"

    @property
    def provenance(self) -> str:
        """Simulated or measured, and how the geometry is known."""
        scene = self.scene
        word = "simulated" if self.simulated or (scene is not None and scene.exact) else "measured"
        if scene is None:
            return f"{word}, rig not given"
        if scene.exact:
            known = self.height.calibration is None
            return f"{word}, {'geometry known' if known else 'heights by another rig than this scene'}"
        rig = f"{word}, rig {self.rig or scene.name}"
        if scene.covariance is None:
            return f"{rig}, typed numbers, not calibrated"
        return f"{rig}, calibrated on {scene.covariance.date or 'a day that its file does not name'}"


@dataclass(frozen=True, eq=False)
class Study:
    """A measurement and what the page computes of it."""

    given: Measurement
    slopes: SlopeMap | None
    curvature: CurvatureMap | None
    fit: FormFit | None
    deviation: HeightMap | None
    terms: ZernikeFit | None
    dents: tuple[Contact, ...] | None

    @classmethod
    def of(cls, given: Measurement) -> "Study":
        height, seen, scene = given.height, given.correspondence, given.scene
        some = bool(height.good.any())
        slopes = None if seen is None or scene is None or not some else slope_map(height, seen, scene)
        fit = _form_fit(given, slopes)
        deviation = None if fit is None else _deviation(height, fit)
        terms = None if deviation is None else _terms(deviation, slopes)
        dents = contacts(height, slopes) if slopes is not None and fit is None else None
        curvature = None if slopes is None else curvature_map(slopes)
        return cls(given, slopes, curvature, fit, deviation, terms, dents)


def _form_fit(given: Measurement, slopes: SlopeMap | None) -> FormFit | None:
    scene, form = given.scene, given.form
    if form is None:
        camera = None if scene is None else scene.camera
        open_air = scene is not None and scene.medium is None and scene.layer is None
        if not (open_air and isinstance(camera, PinholeCamera) and camera.face is None):
            return None
    if form == "" or not given.height.good.any():
        return None
    if form is not None:
        return fit_form(given.height, form, slopes)
    try:
        return fit_form(given.height, "sphere", slopes)
    except InputError:  # flat, or too few pixels for it
        return fit_form(given.height, "tilt", slopes) if given.height.good.sum() > 6 else None


def _deviation(height: HeightMap, fit: FormFit) -> HeightMap:
    """The map less the form, and its modes less what the fit takes off them: to first order the fit's numbers
    move the surface by a plane, and by a quadric or, of a conic, r^4. Its noise is that of the map, an upper
    bound."""
    if height.calibration is None:
        return replace(height, z=fit.residual)
    good = height.good & np.isfinite(fit.residual)
    scale = max(float(np.ptp(part[good])) for part in (height.x, height.y))
    x, y = ((part[good] - at) / scale for part, at in zip((height.x, height.y), fit.middle, strict=True))
    r2 = x * x + y * y
    free, terms = fit.numbers.names, [np.ones_like(x)]
    terms += [x, y] if len(free) > 1 else []
    terms += [r2] if {"power", "radius", "focal"} & set(free) and fit.form != "cylinder" else []
    terms += [x * x, x * y, y * y] if fit.form == "cylinder" else []
    terms += [r2 * r2] if "conic" in free else []
    basis, _ = np.linalg.qr(np.stack(terms, axis=1))
    modes = np.full(height.calibration.shape, np.nan, np.float32)
    for mode, bent in zip(height.calibration, modes, strict=True):
        values = mode[good].astype(np.float64)
        bent[good] = values - basis @ (basis.T @ values)
    return replace(height, z=fit.residual, calibration=modes)


def _terms(deviation: HeightMap, slopes: SlopeMap | None) -> ZernikeFit | None:
    """None where too few pixels are good."""
    try:
        return fit_zernike(deviation, ZERNIKE, slopes)
    except InputError:
        return None
