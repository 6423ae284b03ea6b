"""The page of a measurement, simulated or of a rig, and its files; the prose is in
report/measurement.html.
"""

import time
from collections.abc import Callable
from contextvars import copy_context
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from markupsafe import Markup

from optolever.arrays import Floats
from optolever.blocks import at_once
from optolever.files import save_arrays, together
from optolever.images import png_uri, thin, thumbnail
from optolever.metrology import ZernikeFit
from optolever.patterns import Frame
from optolever.projector import Capture
from optolever.quantities import length_unit
from optolever.samples import DemoResult, Measurement, Study, unflagged

from .flag_table import FlagRow, flag_index, flag_rows, mirror_area
from .height_tables import cards, contacts_table, differences_table, flags_table, form_table, terms_table
from .maps import CAMERA, Data, Layer, camera_map, chart, error_charts, length_layer, mirror_map, surface_data
from .page import Figures, budget_table, embedded_json, write_page
from .rig_drawing import rig_drawing

__all__ = ["write_demo_report", "write_measurement_report"]

_NOISY = 3.0  # medians of its sigma, beyond which a curvature is not drawn
THUMBNAIL, PIXELS = 150, 1_000_000  # of a frame, on its longer side; of all frames, both pictures of each
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
    """Write the page of a run; returns the run with the contacts and the time of the report. full: as below.

    The timing on the page ends when its data are computed.
    """
    start, asked = time.perf_counter(), result.settings
    source = (
        f"scene {asked['scene']}, dent {asked['dent']}, sequence {asked['sequence']}, noise "
        f"{asked['noise']:g} (8-bit levels, rms), seed {asked['seed']}, renderer {asked['renderer']}"
    )
    records = result.height, result.correspondence, result.capture, result.scene, result.truth
    study = Study.of(Measurement(*records, result.metrics, source, simulated=True))
    result = replace(result, contacts=study.contacts or ())
    _write(study, path, lambda: result.with_report(time.perf_counter() - start).seconds, full)
    return result.with_report(time.perf_counter() - start)


def write_measurement_report(path: str | Path, given: Measurement, *, full: bool = False) -> None:
    """Write the page, and the missing data files (FILES) of its folder, atomically. full: correspondence and
    slopes, too, several times the size of all others."""
    start = time.perf_counter()
    _write(Study.of(given), path, lambda: {"report": time.perf_counter() - start}, full)


def _write(study: Study, path: str | Path, seconds: Callable[[], dict[str, float]], full: bool) -> None:
    """seconds: function of the stages' seconds, called when the page's data are computed."""
    figures, folder = Figures(), Path(path).parent
    folder.mkdir(parents=True, exist_ok=True)
    with together():
        own = copy_context()  # a thread has none of `together` by itself
        made, context = at_once(
            lambda: own.run(_save_data, study, folder, full), lambda: _context(study, figures)
        )
        names = [*study.given.saved, *made, "figures.csv"]
        files = {name: text for name, text in FILES.items() if name in names}
        write_page(path, "measurement.html", seconds(), context | {"files": files})
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
    singles: dict[str, dict[str, Any]] = {}
    if full and study.slopes is not None and study.curvature is not None:
        names = ("x", "y", "slope_x", "slope_y", "sigma_x", "sigma_y", "flags")
        singles["slopes.npz"] = {name: getattr(study.slopes, name) for name in names} | {
            f"curvature_{name}": getattr(study.curvature, name) for name in ("mean", "sigma_mean")
        }
    if study.fit is not None:
        study.fit.export(folder / "deviation.npz", given.height)
        made.append("deviation.npz")
    for name, arrays in singles.items():  # in single precision, as the page has them
        save_arrays(
            folder / name,
            {key: a.astype(np.float32) if a.dtype.kind == "f" else a for key, a in arrays.items()},
        )
    return [*made, *singles]


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
    mirror, first, charts, camera, frames, surface = at_once(
        lambda: mirror_map(known, height.y, layers),
        lambda: cards(study, figures),
        lambda: _charts(study),
        lambda: _camera(given, rows),
        lambda: [] if given.capture is None else _frame_pairs(given.capture),
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
        "coordinates": given.correspondence is not None,
        "frames": frames,
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
    for other, less in given.less.items():
        change, spread = (np.where(less.good, part, np.nan) for part in height.difference(less))
        name = f"{given.name} − {other}"
        lengths(name, change, "RdBu_r", True, sigma=f"sigma of {name}")
        sigmas(f"sigma of {name}", spread)
    return layers


def _camera(given: Measurement, rows: list[FlagRow]) -> Data:
    """Layers over the camera's pixels: coordinates, their deviation from the best plane, flags."""
    found, layers = given.correspondence, []
    coordinates = () if found is None else (("u", "column", found.u), ("v", "row", found.v))
    for letter, what, values in coordinates:
        known = thin(np.where(found.good, values, np.nan), CAMERA)  # type: ignore[union-attr]
        layers.append(Layer(f"{letter}: pattern {what}", known, "px", digits=8))
        bent = known - _best_plane(known)
        layers.append(Layer(f"{letter} less its best plane", bent, "px", "RdBu_r", True))
    marked = [row for row in rows if row.bit >= 0]
    index = flag_index(np.asarray(given.height.flags), [row.bit for row in marked])
    return camera_map(layers, index, [(row.name, row.colour) for row in marked])


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


def _frame_pairs(capture: Capture) -> list[dict[str, str]]:
    """Thumbnails of each pattern and camera frame, with a caption."""
    side = min(THUMBNAIL, int(np.sqrt(PIXELS / (2 * len(capture)))))
    return [
        {
            "pattern": png_uri(thumbnail(capture.sequence.render_frame(index), side)),
            "image": png_uri(thumbnail(capture.frames[index], side)),
            "name": f"{index + 1}. {_frame_words(frame)}",
        }
        for index, frame in enumerate(capture.sequence.frames)
    ]


def _frame_words(frame: Frame) -> str:
    """Caption of a frame."""
    words = [
        frame.kind if frame.axis is None else f"{frame.kind} on {frame.axis}",
        "" if frame.bit is None else f"bit {frame.bit}",
        "inverted" if frame.inverted else "",
        "" if frame.period_px is None else f"period {frame.period_px:.4g} px",
        "" if frame.shift is None else f"shift {np.degrees(frame.shift):.0f}°",
    ]
    return ", ".join(filter(None, words))


def _best_plane(values: Floats) -> Floats:
    """The least-squares plane through the finite values, on every pixel."""
    row, col = np.meshgrid(*(np.linspace(-1, 1, n) for n in values.shape), indexing="ij")
    use = np.isfinite(values)
    if not use.any():
        return np.zeros(values.shape)
    basis = np.stack([np.ones(int(use.sum())), row[use], col[use]])
    a, b, c = np.linalg.lstsq(basis @ basis.T, basis @ values[use], rcond=None)[0]
    return np.asarray(a + b * row + c * col, dtype=np.float64)
