"""A measurement and the derived results of its page: slopes, form and deviation from it, contacts."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from optolever.blocks import at_once
from optolever.decode import Correspondence
from optolever.errors import InputError
from optolever.metrology import FormFit, ZernikeFit, aperture_circle, aperture_mask, fit_form, fit_zernike
from optolever.notices import Notice
from optolever.reconstruct import (
    Contact,
    CurvatureMap,
    HeightMap,
    SlopeMap,
    budget,
    contacts,
    curvature_map,
    slope_map,
)
from optolever.scene import Scene, Trace

__all__ = ["Measurement", "Study"]

ZERNIKE = 6  # radial order
_SAMPLE, _OFF_RAY = 2000, 0.1  # pixels; of a pixel on the mirror
_OTHER, _PART = 10.0, 0.3  # sigmas of slopes, 1.3 where right; of the slopes themselves


@dataclass(frozen=True, eq=False)
class Measurement:
    """A measurement: the height map, and if known its correspondence and scene, and the truth.

    metrics: against the truth (`metrics.height_metrics`). source: origin of the map; name: of the map in
    differences; rig: file of the scene; origin: 'simulated', 'measured' or '', not known. form: to be
    subtracted (`metrology.fit_form`); '': none; None: a sphere for a mirror in open air. less: maps of the
    same rig by name, for differences. saved: existing files of the page's folder.
    rest: the correspondence of the mirror at rest, of a map reconstructed against it. apertures: of the form
    and its deviation (`metrology.aperture_mask`). waves: nm, of the wavefront on the page (None: none).
    apart: the records are of files that may not belong together; InputError where they contradict each other.
    """

    height: HeightMap
    correspondence: Correspondence | None = None
    scene: Scene | None = None
    truth: Trace | None = None
    metrics: Mapping[str, float] = field(default_factory=dict)
    source: str = ""
    name: str = "this map"
    rig: str = ""
    origin: str = ""
    form: str | None = None
    less: Mapping[str, HeightMap] = field(default_factory=dict)
    saved: tuple[str, ...] = ()
    rest: Correspondence | None = None
    apertures: tuple[str, ...] = ()
    waves: float | None = None
    apart: bool = False

    def __post_init__(self) -> None:
        size, own = self.height.z.shape, self.correspondence
        sizes = {
            "correspondence: has": None if own is None else own.u.shape,
            "scene: its camera has": None
            if self.scene is None
            else (self.scene.camera.rows, self.scene.camera.cols),
        }
        for name, found in sizes.items():
            if found is not None and found != size:
                wrong = "{} x {} pixels, must be {} x {} as the height map".format(*found, *size)
                raise InputError(f"{name} {wrong}; give that of this map")
        if own is None or not self.apart:
            return
        if (self.height.good & ~own.good).any():
            what = f"knows {(self.height.good & ~own.good).sum()} good pixels of the height map not"
            raise InputError(f"correspondence: {what}; give the one that it was reconstructed from")

    @property
    def notices(self) -> tuple[Notice, ...]:
        """Notices of the map, preceded by those of records that are not of this map."""
        changes = (self.height - other for other in self.less.values())
        own = *self._other_rig(), *self._other_rest(), *self.height.notices
        return tuple(dict.fromkeys((*own, *(each for change in changes for each in change.notices))))

    def _other_rest(self) -> list[Notice]:
        """Whether either the heights or the slopes alone are less a rest capture."""
        less = any(name.startswith("rest ") for name in self.height.references)
        if self.correspondence is None or self.scene is None or less == (self.rest is not None):
            return []
        parts = "heights", "slopes and contacts"
        name = "The {} are relative to a rest capture, the {} are not".format(
            *(parts if less else parts[::-1])
        )
        cure = "give the same to both: report --rest" if less else "give the same to both: reconstruct --rest"
        return [Notice(name, np.nan, np.nan, cure)]

    def _other_rig(self) -> list[Notice]:
        """Whether the map's points lie off the camera rays of the scene."""
        height, scene = self.height, self.scene
        known = height.good & np.isfinite(height.z)
        if scene is None or not known.any():
            return []
        row, col = (part[:: max(1, len(part) // _SAMPLE)] for part in np.nonzero(known))
        origins, ways = scene.camera.rays_at(row.astype(np.float64), col.astype(np.float64))
        away = np.stack([part[row, col] for part in (height.x, height.y, height.z)], axis=-1) - origins
        miss = float(np.median(np.linalg.norm(np.cross(away, ways), axis=-1)))
        pixel = float(np.sqrt(scene.mirror.length * scene.mirror.width / height.z.size))
        if miss <= _OFF_RAY * pixel:
            return []
        text = f"The points of the map lie {miss:.2g} mm off the camera rays of the scene"
        cure = "give the rig that the heights were reconstructed with; slopes and areas are wrong"
        return [Notice(text, miss, np.nan, cure)]

    @property
    def open_air(self) -> bool:
        """Whether the map is of a mirror in open air, no sensor; without a scene: whether a form is named."""
        scene = self.scene
        if scene is None:
            return bool(self.form)
        return scene.open_air and scene.layer is None

    @cached_property
    def readings(self) -> dict[str, dict[str, float]]:
        """`reconstruct.budget` of the map and of every difference; a mirror in open air has no dent."""
        found = budget(self.height)
        if self.open_air:
            found.pop("over surroundings (deepest)", None)
            found = {name.replace("(deepest)", "(largest)"): sources for name, sources in found.items()}
        for name, other in self.less.items():
            change = budget(self.height, other).get("difference of maps", {})
            found[f"{self.name} − {name}, largest"] = change
        return found

    @property
    def provenance(self) -> str:
        """Simulated or measured, if that is known, and how the geometry is known."""
        scene, word = self.scene, self.origin and f"{self.origin}, "
        if scene is None:
            return f"{word}rig not given"
        if scene.exact:
            known = self.height.modes is None
            return f"simulated, {'geometry known' if known else 'heights by another rig than this scene'}"
        rig = f"{word}rig {self.rig or scene.name}"
        if scene.covariance is None:
            return f"{rig}, typed numbers, not calibrated"
        return f"{rig}, calibrated on {scene.covariance.date or 'a day that its file does not name'}"


@dataclass(frozen=True, eq=False)
class Study:
    """A measurement and its derived results."""

    given: Measurement
    slopes: SlopeMap | None
    curvature: CurvatureMap | None
    fit: FormFit | None
    deviation: HeightMap | None
    terms: ZernikeFit | None
    contacts: tuple[Contact, ...] | None

    @classmethod
    def of(cls, given: Measurement) -> Study:
        height = given.height
        (slopes, curvature), pressed = at_once(lambda: _slopes(given), lambda: _contacts(given))
        fit = _form_fit(given, slopes)
        deviation = None if fit is None else fit.deviation(height)
        terms = None if fit is None or deviation is None else _terms(deviation, slopes, given, fit)
        return cls(given, slopes, curvature, fit, deviation, terms, pressed)


def _slopes(given: Measurement) -> tuple[SlopeMap, CurvatureMap] | tuple[None, None]:
    """With the curvature. InputError: they are not of the heights, and the records may be of two maps."""
    height, found, scene = given.height, given.correspondence, given.scene
    if found is None or scene is None or not height.good.any():
        return None, None
    # forms alone need no slopes of the modes
    slopes = slope_map(replace(height, modes=None) if given.open_air else height, found, scene, given.rest)
    if given.apart and height.against_rest == (given.rest is not None):
        _require_same(height, slopes)
    return slopes, curvature_map(slopes)


def _contacts(given: Measurement) -> tuple[Contact, ...] | None:
    """Of the map's file, else of its heights; None of a mirror in open air."""
    height, scene = given.height, given.scene
    if height.contacts is not None or scene is None or given.open_air or not height.good.any():
        return height.contacts
    return contacts(height, scene.layer)


def _require_same(height: HeightMap, slopes: SlopeMap) -> None:
    """InputError where slopes are not the gradient of the heights: correspondence or rest of other maps."""
    points = (np.where(slopes.good, part, np.nan) for part in (height.x, height.y, height.z))
    x, y, z = (np.asarray(np.gradient(part)) for part in points)
    off = np.abs(z - slopes.slope_x * x - slopes.slope_y * y)
    sigmas = off / np.hypot(slopes.sigma_x * x, slopes.sigma_y * y)
    if not np.isfinite(sigmas).any():
        return
    worst, step = (float(np.nanquantile(part, 0.95)) for part in (sigmas, off))
    if worst > _OTHER and step > _PART * np.nanquantile(np.abs(z), 0.95):
        wrong = f"slopes differ from the heights' gradient by {worst:.2g} sigma in 5 % of the pixels"
        raise InputError(f"correspondence: its {wrong}; give it and the rest that the map was made of")


def _aperture(given: Measurement) -> NDArray[np.bool_] | None:
    height = given.height
    if not given.apertures:
        return None
    return aperture_mask(given.apertures, height.x, height.y, height.good)


def _form_fit(given: Measurement, slopes: SlopeMap | None) -> FormFit | None:
    form = ("sphere" if given.open_air else "") if given.form is None else given.form
    if not form or not given.height.good.any():
        return None
    try:
        return fit_form(given.height, form, slopes, _aperture(given))
    except InputError:  # flat, or too few pixels for the default
        if given.form is not None:
            raise
        return (
            fit_form(given.height, "tilt", slopes, _aperture(given)) if given.height.good.sum() > 6 else None
        )


def _terms(
    deviation: HeightMap, slopes: SlopeMap | None, given: Measurement, fit: FormFit
) -> ZernikeFit | None:
    """None where too few pixels are good."""
    try:
        centre, radius = aperture_circle(given.apertures, deviation.x, deviation.y, given.height.good)
        return fit_zernike(deviation, ZERNIKE, slopes, radius, removed=fit, centre=centre)
    except InputError:
        return None
