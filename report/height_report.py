"""The page of a measurement, simulated or of a rig, and its files; the prose is in
report/measurement.html.
"""

import time
from contextvars import copy_context
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from markupsafe import Markup

from optolever.arrays import Floats
from optolever.blocks import at_once
from optolever.files import save_arrays, together
from optolever.metrology import ZernikeFit
from optolever.quantities import length_unit
from optolever.samples import DemoResult, Measurement, Study, unflagged

from .flag_table import flag_rows, mirror_area
from .height_tables import cards, contacts_table, differences_table, flags_table, form_table, terms_table
from .maps import Data, Layer, camera_map, chart, error_charts, length_layer, mirror_map, surface_data
from .page import Figures, budget_table, embedded_json, write_page
from .rig_drawing import rig_drawing

__all__ = ["write_demo_report", "write_measurement_report"]

_NOISY = 3.0  # medians of its sigma, beyond which a curvature is not drawn
#: Files of the page's folder, and their content.
FILES = {
    "figures.csv": "every number of this page",
    "height.npz": "x, y, z, sigma (mm), flags",
    "slopes.npz": "slopes, curvature and their sigmas",
    "deviation.npz": "height less the form (mm), as height.npz, and its slopes",
    "correspondence.npz": "u, v and their sigmas (pattern pixels), flags",
    "h.npz": "x, y, z, sigma (mm), flags",
    "c.npz": "u, v and their sigmas (pattern pixels), flags",
}


def write_demo_report(result: DemoResult, path: str | Path, *, full: bool = False) -> DemoResult:
    """Write the page of a run; returns it with contacts and the time of the report. full: as below."""
    start, asked = time.perf_counter(), result.settings
    source = (
        f"scene {asked['scene']}, dent {asked['dent']}, sequence {asked['sequence']}, noise "
        f"{asked['noise']:g} (8-bit levels, rms), seed {asked['seed']}, renderer {asked['renderer']}"
    )
    records = result.height, result.correspondence, result.scene, result.truth
    study = Study.of(Measurement(*records, result.metrics, source, origin="simulated"))
    result = replace(result, contacts=study.contacts or ())
    _write(study, path, full)
    return result.with_report(time.perf_counter() - start)


def write_measurement_report(path: str | Path, given: Measurement, *, full: bool = False) -> None:
    """Write the page, and the missing data files (FILES) of its folder, atomically. full: correspondence and
    slopes, too, several times the size of all others."""
    _write(Study.of(given), path, full)


def _write(study: Study, path: str | Path, full: bool) -> None:
    figures, folder = Figures(), Path(path).parent
    folder.mkdir(parents=True, exist_ok=True)
    with together():
        own = copy_context()  # a thread has none of `together` by itself
        made, context = at_once(
            lambda: own.run(_save_data, study, folder, full), lambda: _context(study, figures)
        )
        names = [*study.given.saved, *made, "figures.csv"]
        files = {name: text for name, text in FILES.items() if name in names}
        write_page(path, "measurement.html", context | {"files": files})
        figures.save(folder / "figures.csv")


def _save_data(study: Study, folder: Path, full: bool) -> list[str]:
    """Write the files that are not yet in the folder; their names."""
    given, made = study.given, []
    if "h.npz" not in given.saved:
        given.height.save(folder / "height.npz")
        made.append("height.npz")
    if full and given.correspondence is not None and "c.npz" not in given.saved:
        given.correspondence.save(folder / "correspondence.npz")
        made.append("correspondence.npz")
    if full and study.slopes is not None and study.curvature is not None:
        names = ("x", "y", "slope_x", "slope_y", "sigma_x", "sigma_y")
        arrays = {name: getattr(study.slopes, name) for name in names}
        arrays |= {f"curvature_{name}": getattr(study.curvature, name) for name in ("mean", "sigma_mean")}
        single = {name: values.astype(np.float32) for name, values in arrays.items()}  # as the page has them
        save_arrays(folder / "slopes.npz", single | {"flags": study.slopes.flags})
        made.append("slopes.npz")
    if study.fit is not None:
        study.fit.export(folder / "deviation.npz", given.height)
        made.append("deviation.npz")
    return made


def _context(study: Study, figures: Figures) -> dict[str, Any]:
    given, height = study.given, study.given.height
    layers, scene = _layers(study), given.scene
    known = np.where(height.good, height.x, np.nan)
    area = None if scene is None else mirror_area(scene)
    size = 0.0 if scene is None else scene.mirror.length * scene.mirror.width
    rows = flag_rows(height.flags, area, size)
    drawing, bar = (Markup(""), 0.0) if scene is None else rig_drawing({"rig": scene})
    fit, terms, middle = study.fit, study.terms, Markup("")
    form = None if fit is None else form_table(fit, figures)
    if fit is not None:
        at = (
            figures.show(f"middle {axis}", value, "mm") for axis, value in zip("xy", fit.middle, strict=True)
        )
        middle = Markup(", ").join(at)
    main = (height, "height", False) if study.deviation is None else (study.deviation, "deviation", True)
    mirror, first, charts, camera, surface = at_once(
        lambda: mirror_map(known, height.y, layers),
        lambda: cards(study, figures),
        lambda: _charts(study),
        lambda: camera_map(np.asarray(height.flags), rows),
        lambda: surface_data(*main),
    )
    return {
        "provenance": given.provenance,
        "source": given.source,
        "size": height.z.shape,
        "notices": given.notices,
        "cards": first,
        "maps": embedded_json({"mirror": mirror, "camera": camera}),
        "charts": embedded_json(charts),
        "layers": [layer.name for layer in layers],
        "differenced": [f"{given.name} − {name}" for name in given.less],
        "surface": surface,
        "surface_json": embedded_json(surface),
        "fit": fit,
        "form": form,
        "middle": middle,
        "terms": None if terms is None else terms_table(terms, figures),
        "radius": "" if terms is None else figures.show("radius of the circle", terms.radius, "mm"),
        "contacts": None if study.contacts is None else contacts_table(study.contacts, figures),
        "pressed": bool(study.contacts),
        "forceless": any(each.force is None for each in study.contacts or ()),
        "differences": differences_table(given, figures) if given.less else None,
        "budget": budget_table(given.readings, figures),
        "flags": flags_table(rows, area is not None, figures),
        "areas": area is not None,
        "truth": given.truth is not None,
        "drawing": drawing,
        "bar": bar,
    }


def _layers(study: Study) -> list[Layer]:
    """Layers of the map over the mirror; the first is the height or its deviation."""
    given, height = study.given, study.given.height
    layers = list[Layer]()

    def lengths(name: str, values: Floats, *colours: Any, **more: Any) -> None:
        layers.append(length_layer(name, np.where(height.good, values, np.nan), *colours, **more))

    def sigmas(name: str, values: Floats) -> None:
        lengths(name, values, "cividis", digits=3)

    def signed(name: str, values: Floats, unit: str, **more: Any) -> None:
        known = np.where(height.good, values, np.nan)
        layers.append(Layer(name, known, unit, "RdBu_r", True, factor=1e3, **more))

    if study.deviation is not None:
        name = "sigma of the deviation"
        lengths("deviation", study.deviation.z, "RdBu_r", True, sigma=name, digits=7)
        sigmas(name, study.deviation.total_sigma)
    true = "true height" if given.truth is not None else ""
    strip = "error" if true else "deviation" if study.deviation is not None else ""
    lengths("height", height.z, sigma="sigma", true=true, strip=strip, digits=7)
    sigmas("sigma", height.total_sigma)
    if height.modes is not None:
        sigmas("sigma by noise", height.sigma)
        sigmas("sigma by the rig", height.calibration_sigma)
    if given.truth is not None:
        lengths("true height", given.truth.z, digits=7)
        error = np.where(unflagged(given.truth, height), height.z - given.truth.z, np.nan)
        lengths("error", error, "RdBu_r", True, sigma="sigma", digits=4)
    if study.slopes is not None and study.curvature is not None:
        signed("slope x", study.slopes.slope_x, "mrad")
        signed("slope y", study.slopes.slope_y, "mrad")
        sigma = study.curvature.sigma_mean
        usual = sigma <= _NOISY * np.median(sigma[height.good]) if height.good.any() else height.good
        signed("mean curvature", np.where(usual, study.curvature.mean, np.nan), "1/m", digits=4, share=0.96)
    if given.correspondence is not None:
        for name, places in (("u", given.correspondence.u), ("v", given.correspondence.v)):
            layers.append(Layer(name, np.where(height.good, places, np.nan), "px", digits=8))
    for other, less in given.less.items():
        change, spread = (np.where(less.good, part, np.nan) for part in height.difference(less))
        name = f"{given.name} − {other}"
        lengths(name, change, "RdBu_r", True, sigma=f"sigma of {name}")
        sigmas(f"sigma of {name}", spread)
    return layers


def _charts(study: Study) -> dict[str, Data]:
    """Charts, by the id of their figure."""
    given, height, charts = study.given, study.given.height, dict[str, Data]()
    if study.terms is not None:
        charts["zernike"] = _terms_chart(study.terms)
    if given.truth is not None and given.correspondence is not None:
        truth, found = given.truth, given.correspondence
        decoded, stands = found.good & truth.visible, unflagged(truth, height)
        sigma = height.total_sigma
        factor, unit = length_unit(float(np.median(sigma[stands])) if stands.any() else np.nan)
        charts |= error_charts("u", (found.u - truth.u)[decoded], found.sigma_u[decoded], "px")
        charts |= error_charts("v", (found.v - truth.v)[decoded], found.sigma_v[decoded], "px")
        error = factor * (height.z - truth.z)[stands]
        charts |= error_charts("height", error, factor * sigma[stands], unit)
    return charts


def _terms_chart(terms: ZernikeFit) -> Data:
    """Zernike coefficients, piston and tilt aside, and their sigmas."""
    numbers = terms.listed()
    use = list(range(3, len(numbers.names)))
    factor, unit = length_unit(float(np.abs(numbers.values[use]).max()))
    values, sigma = factor * numbers.values[use], factor * numbers.sigma[use]
    lines = {"coefficient": ("bars", values)}
    if np.isfinite(sigma).any():
        lines |= {"+ 2 sigma": ("points", values + 2 * sigma), "− 2 sigma": ("points", values - 2 * sigma)}
    names = [numbers.names[k].partition(" ")[0] for k in use]
    return chart(np.arange(len(use)), lines, ("", f"coefficient [{unit} rms]"), names=names)
