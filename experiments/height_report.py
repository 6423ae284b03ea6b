"""The page of a measurement, simulated or of a rig, and its files; the prose is in
report/measurement.html.
"""

import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from markupsafe import Markup
from numpy.typing import NDArray

from optolever.decode import Correspondence
from optolever.files import report_folder, save_arrays, together
from optolever.patterns import Frame
from optolever.projector import Capture
from optolever.quantities import length_unit
from optolever.scene import Trace

from .arrays import Floats
from .demo import DemoResult
from .figures import Figures
from .flag_table import FlagRow, flag_index, flag_rows, mirror_area
from .height_tables import (
    budget_table,
    cards,
    dents_table,
    differences_table,
    flags_table,
    form_table,
    terms_table,
)
from .images import png_uri, thumbnail
from .maps import (
    Data,
    Layer,
    Scores,
    camera_map,
    chart,
    histogram,
    length_layer,
    mirror_map,
    reliability_chart,
    scores,
    surface_data,
)
from .measurement import Measurement, Study
from .metrics import unflagged
from .page import embedded_json, write_page
from .rig_drawing import rig_drawing

__all__ = ["write_demo_report", "write_measurement_report"]

THUMBNAIL, PIXELS = 150, 1_000_000  # of a frame, on its longer side; of all frames, both pictures of each
#: Files of the page's folder, and their content.
FILES = {
    "figures.csv": "every number of this page",
    "height.npz": "x, y, z, sigma (mm), flags",
    "slopes.npz": "slopes, curvature and their sigmas",
    "deviation.npz": "x, y, height less the form (mm), its slopes",
    "correspondence.npz": "u, v and their sigmas (pattern pixels), flags",
    "h.npz": "x, y, z, sigma (mm), flags",
    "c.npz": "u, v and their sigmas (pattern pixels), flags",
}


def write_demo_report(result: DemoResult, path: str | Path) -> DemoResult:
    """Write the page of a run; returns the run with the dents and the time of the report.

    The timing on the page ends when its data are computed.
    """
    start = time.perf_counter()
    asked = result.settings
    study = Study.of(
        Measurement(
            result.height,
            result.correspondence,
            result.capture,
            result.scene,
            result.truth,
            f"scene {asked['scene']}, dent {asked['dent']}, sequence {asked['sequence']}, noise "
            f"{asked['noise']:g} (8-bit levels, rms), seed {asked['seed']}, renderer {asked['renderer']}",
            simulated=True,
        )
    )
    result = replace(result, contacts=study.dents or ())
    _write(study, path, lambda: result.with_report(time.perf_counter() - start).seconds)
    return result.with_report(time.perf_counter() - start)


def write_measurement_report(path: str | Path, given: Measurement) -> None:
    """Write the page, and the missing data files (FILES) of its folder, atomically."""
    start = time.perf_counter()
    _write(Study.of(given), path, lambda: {"report": time.perf_counter() - start})


def _write(study: Study, path: str | Path, seconds: Callable[[], dict[str, float]]) -> None:
    """seconds: function of the stages' seconds, called when the page's data are computed."""
    figures, folder = Figures(), Path(path).parent
    context = _context(study, figures)
    with report_folder(folder), together():
        names = [*study.given.saved, *_save_data(study, folder), "figures.csv"]
        files = [{"name": name, "holds": FILES[name]} for name in FILES if name in names]
        write_page(path, "measurement.html", seconds(), context | {"files": files})
        figures.save(folder / "figures.csv")


def _save_data(study: Study, folder: Path) -> list[str]:
    given, made = study.given, []
    if "h.npz" not in given.saved:
        given.height.save(folder / "height.npz")
        made.append("height.npz")
    if given.correspondence is not None and "c.npz" not in given.saved:
        given.correspondence.save(folder / "correspondence.npz")
        made.append("correspondence.npz")
    if study.slopes is not None and study.curvature is not None:
        bent = {f"curvature_{name}": getattr(study.curvature, name) for name in ("mean", "sigma_mean")}
        names = ("x", "y", "slope_x", "slope_y", "sigma_x", "sigma_y", "flags")
        _save_single(folder / "slopes.npz", {name: getattr(study.slopes, name) for name in names} | bent)
        made.append("slopes.npz")
    if study.fit is not None:
        form = {name: getattr(study.fit, name) for name in ("x", "y", "residual", "slope_x", "slope_y")}
        _save_single(folder / "deviation.npz", form)
        made.append("deviation.npz")
    return made


def _save_single(path: Path, arrays: Mapping[str, NDArray[Any]]) -> None:
    """In single precision, as the page has them; flags as they are."""
    single = {name: a.astype(np.float32) if a.dtype.kind == "f" else a for name, a in arrays.items()}
    save_arrays(path, single)


def _context(study: Study, figures: Figures) -> dict[str, Any]:
    given = study.given
    height = given.height
    layers = _layers(study)
    area = None if given.scene is None else mirror_area(given.scene)
    size = 0.0 if given.scene is None else given.scene.mirror.length * given.scene.mirror.width
    rows = flag_rows(height.flags, area, size)
    drawing, bar = (Markup(""), 0.0) if given.scene is None else rig_drawing({"rig": given.scene})
    known = np.where(height.good, height.x, np.nan)
    shape = given.height.z if study.fit is None else study.fit.residual
    surface = surface_data(height.x, height.y, np.where(height.good, shape, np.nan), _surface(study))
    return {
        "provenance": given.provenance,
        "source": given.source,
        "size": height.z.shape,
        "notices": given.notices,
        "cards": cards(study, figures),
        "maps": embedded_json(
            {"mirror": mirror_map(known, height.y, layers), "camera": _camera(given, rows)}
        ),
        "charts": embedded_json(_charts(study)),
        "layers": [layer.name for layer in layers],
        "differenced": [f"{given.name} − {name}" for name in given.less],
        "surface": surface,
        "surface_json": embedded_json(surface),
        "form": form_table(study, figures),
        "terms": None if study.terms is None else terms_table(study.terms, figures),
        "dents": study.dents if study.dents is None else dents_table(study.dents, figures),
        "differences": differences_table(given, figures),
        "budget": budget_table(given, figures),
        "flags": flags_table(rows, area is not None, figures),
        "truth": given.truth is not None,
        "seen": given.correspondence is not None,
        "frames": [] if given.capture is None else _frame_pairs(given.capture),
        "drawing": drawing,
        "bar": bar,
    }


def _layers(study: Study) -> list[Layer]:
    """Layers of the map over the mirror; the first is the height or its deviation."""
    given, good = study.given, study.given.height.good

    def known(values: Floats) -> Floats:
        return np.where(good, values, np.nan)

    height = given.height
    sigma = known(height.total_sigma)
    layers = []
    if study.deviation is not None:
        spread = known(study.deviation.total_sigma)
        name = "sigma of the deviation"
        bent = known(study.deviation.z)
        layers.append(length_layer("deviation", bent, "RdBu_r", True, sigma=name, digits=7))
        layers.append(length_layer(name, spread, "cividis", digits=3))
    true = "true height" if given.truth is not None else ""
    layers.append(length_layer("height", known(height.z), sigma="sigma", true=true, digits=7))
    layers.append(length_layer("sigma", sigma, "cividis", digits=3))
    if height.modes is not None:
        layers.append(length_layer("sigma by noise", known(height.sigma), "cividis", digits=3))
        layers.append(length_layer("sigma by the rig", known(height.calibration_sigma), "cividis", digits=3))
    if given.truth is not None:
        error = np.where(unflagged(given.truth, height), height.z - given.truth.z, np.nan)
        layers.append(length_layer("true height", known(given.truth.z), digits=7))
        layers.append(length_layer("error", error, "RdBu_r", True, sigma="sigma", digits=4))
    if study.slopes is not None and study.curvature is not None:
        for name, values in (("slope x", study.slopes.slope_x), ("slope y", study.slopes.slope_y)):
            layers.append(Layer(name, known(values), "mrad", "RdBu_r", True, factor=1e3))
        bent = known(study.curvature.mean)
        layers.append(Layer("mean curvature", bent, "1/m", "RdBu_r", True, factor=1e3, digits=4))
    for name, other in given.less.items():
        change, spread = height.difference(other)
        both = good & other.good
        label = f"sigma of {given.name} − {name}"
        change = np.where(both, change, np.nan)
        layers.append(length_layer(f"{given.name} − {name}", change, "RdBu_r", True, sigma=label))
        layers.append(length_layer(label, np.where(both, spread, np.nan), "cividis", digits=3))
    return layers


def _surface(study: Study) -> dict[str, tuple[Floats, str, str, bool]]:
    """Colourings of the surface."""
    height, good = study.given.height, study.given.height.good
    name, values, colours = ("height", height.z, "viridis")
    if study.fit is not None:
        name, values, colours = "deviation", study.fit.residual, "RdBu_r"
    sigma = (study.deviation or height).total_sigma
    factor, unit = length_unit(float(np.median(sigma[good])) if good.any() else np.nan)
    return {
        name: (np.where(good, values, np.nan), "mm", colours, study.fit is not None),
        "sigma": (np.where(good, sigma, np.nan) * factor, unit, "cividis", False),
    }


def _camera(given: Measurement, rows: list[FlagRow]) -> Data:
    """Layers over the camera's pixels: coordinates, their deviation from the best plane, flags."""
    seen, layers = given.correspondence, []
    for letter, what in (("u", "column"), ("v", "row")) if seen is not None else ():
        values = np.where(seen.good, getattr(seen, letter), np.nan)  # type: ignore[union-attr]
        layers.append(Layer(f"{letter}: pattern {what}", values, "px", digits=8))
        bent = values - _best_plane(values)
        layers.append(Layer(f"{letter} less its best plane", bent, "px", "RdBu_r", True))
    marked = [row for row in rows if row.bit >= 0]
    index = flag_index(np.asarray(given.height.flags), [row.bit for row in marked])
    return camera_map(layers, index, [(row.name, row.colour) for row in marked])


def _charts(study: Study) -> dict[str, Data]:
    """Charts, by the id of their figure."""
    given, charts = study.given, {}
    if study.terms is not None:
        numbers = study.terms.numbers
        use = [k for k, name in enumerate(numbers.names) if name not in ("Z(0,0)", "Z(1,-1)", "Z(1,1)")]
        factor, unit = length_unit(float(np.abs(numbers.values[use]).max()))
        values, sigma = factor * numbers.values[use], factor * numbers.sigma[use]
        lines = {"coefficient": ("bars", values)}
        if np.isfinite(sigma).any():
            lines |= {
                "+ 2 sigma": ("points", values + 2 * sigma),
                "− 2 sigma": ("points", values - 2 * sigma),
            }
        names = [numbers.names[k] for k in use]
        charts["zernike"] = chart(np.arange(len(use)), lines, ("", f"coefficient [{unit} rms]"), names=names)
    if given.truth is not None and given.correspondence is not None:
        for name, (found, unit) in _scores(given, given.correspondence, given.truth).items():
            charts[f"histogram-{name}"] = histogram(name, found)
            charts[f"reliability-{name}"] = reliability_chart(name, found, unit)
    return charts


def _scores(given: Measurement, seen: Correspondence, truth: Trace) -> dict[str, tuple[Scores, str]]:
    height, decoded = given.height, seen.good & truth.visible
    stands = unflagged(truth, height)
    factor, unit = length_unit(float(np.median(height.total_sigma[stands])) if stands.any() else np.nan)
    return {
        "u": (scores(seen.u - truth.u, seen.sigma_u, decoded), "px"),
        "v": (scores(seen.v - truth.v, seen.sigma_v, decoded), "px"),
        "height": (scores(factor * (height.z - truth.z), factor * height.total_sigma, stands), unit),
    }


def _frame_pairs(capture: Capture) -> list[dict[str, str]]:
    """Thumbnails of each displayed and captured frame, with a caption."""
    side = min(THUMBNAIL, int(np.sqrt(PIXELS / (2 * len(capture)))))
    return [
        {
            "shown": png_uri(thumbnail(capture.sequence.render_frame(index), side)),
            "seen": png_uri(thumbnail(capture.frames[index], side)),
            "name": f"{index + 1}. {_frame_words(frame)}",
        }
        for index, frame in enumerate(capture.sequence.frames)
    ]


def _frame_words(frame: Frame) -> str:
    """Caption of a frame."""
    words = [frame.kind if frame.axis is None else f"{frame.kind} on {frame.axis}"]
    if frame.bit is not None:
        words.append(f"bit {frame.bit}")
    if frame.inverted:
        words.append("inverted")
    if frame.period_px is not None:
        words.append(f"period {frame.period_px:.4g} px")
    if frame.shift is not None:
        words.append(f"shift {np.degrees(frame.shift):.0f}°")
    return ", ".join(words)


def _best_plane(values: Floats) -> Floats:
    """The least-squares plane through the finite values, on every pixel."""
    row, col = np.meshgrid(*(np.linspace(-1, 1, n) for n in values.shape), indexing="ij")
    use = np.isfinite(values)
    if not use.any():
        return np.zeros(values.shape)
    basis = np.stack([np.ones(int(use.sum())), row[use], col[use]])
    a, b, c = np.linalg.lstsq(basis @ basis.T, basis @ values[use], rcond=None)[0]
    return np.asarray(a + b * row + c * col, dtype=np.float64)
