"""`optolever reconstruct --scene RESULT.h5,all`: each facet of a SOFAST ensemble, its slope deviation."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import optolever as ol
from optolever import InputError
from optolever.quantities import by_parts

from .batch import Many
from .printing import grid, write_json

__all__ = ["OfFacets"]

_HEAD = ("facet", "focal length", "slope deviation along x, rms", "along y")


class OfFacets(Many):
    """A command of one facet, or of all, whose names end the names of the files."""

    def run(self, parameters: Mapping[str, Any]) -> Any:
        """Of all: heights, slopes, a picture of the slopes less a paraboloid's; their rms in a table."""
        result, _, facet = str(parameters["scene_name"]).rpartition(",")
        if facet != "all":
            return super().run(parameters)
        if parameters["truth"] or parameters["slopes_path"]:
            raise InputError(f"--scene {result},all: --truth and --slopes are of one facet; leave them out")
        out, found, code = parameters["out"], dict[str, dict[str, tuple[float, ...]]](), 0
        for name in ol.formats.sofast_facets(result):
            height, slopes = (out.with_name(f"{out.stem}_{name}{end}.npz") for end in ("", "_slopes"))
            one = {"scene_name": f"{result},{name}", "out": height, "slopes_path": slopes, "json_path": None}
            code = max(code, super().run({**parameters, **one}))
            found[name] = _deviation(height, slopes)
        rows = (
            (name, by_parts(focal, "mm"), *(by_parts([1e3 * each for each in one], "mrad") for one in slopes))
            for name, (focal, *slopes) in ((name, each.values()) for name, each in found.items())
        )
        grid("Facets, less the paraboloid of each", _HEAD, rows)
        write_json(parameters["json_path"], found)
        return code


def _deviation(height: Path, slopes: Path) -> dict[str, tuple[float, ...]]:
    """Of a facet's paraboloid: value and sigma by noise and rig of its focal length (mm) and of the slopes
    beside it (rad); these are drawn beside the map of slopes."""
    from matplotlib.figure import Figure

    from optolever.records import plot_maps

    given = ol.reconstruct.HeightMap.load(height), "paraboloid", ol.reconstruct.SlopeMap.load(slopes)
    fit = ol.metrology.fit_form(*given)
    figure = Figure(figsize=(9.6, 4.2), layout="constrained")
    titles = (f"slope deviation along {axis}, mrad" for axis in "xy")
    plot_maps(dict(zip(titles, (1e3 * one for one in fit.slopes), strict=True)), figure.subplots(1, 2))
    with ol.files.atomic_file(slopes.with_suffix(".png")) as temporary:
        figure.savefig(temporary, metadata={"Software": ol.files.MARK.decode()})
    along_x, along_y = ol.metrology.slope_errors(fit)
    k = fit.numbers.names.index("focal")
    focal = tuple(float(each[k]) for each in (fit.numbers.values, fit.numbers.noise, fit.numbers.rig))
    return {"focal_mm": focal, "slope_x": along_x.known, "slope_y": along_y.known}
