"""`optolever form`: a height map without its form: radius, residual, slope error, Zernike coefficients."""

from collections.abc import Iterator
from dataclasses import fields
from pathlib import Path
from typing import Annotated

import click

import optolever as ol
from optolever.quantities import quantity

from .arguments import Arg, Opt, Rare, program
from .options import Json, blame
from .outputs import OutputFile
from .show import grid, length, number, table, write_json

SAMPLE = """
$ optolever form h.npz --remove sphere
Form of h.npz: sphere; x, y from the middle (150.021, 150) mm
number    value ± sigma            noise    rig
vertex_x  −0.022879 ± 0.000063     6.3e-05  0
vertex_y  0.001375 ± 0.000065      6.5e-05  0
vertex_z  4.065 × 10⁻⁴             -        0
radius    4000.5960 ± 0.0023       0.0023   0
Residual
  heights      4.6e+02 nm rms, 3.6 um from valley to peak
  slope error  29.1 urad rms along x, 29.11 urad along y
  left out     the outermost ring of good pixels, whose centres may see no mirror
"""


CSV = OutputFile(".csv")
REMOVE = Opt(
    "--remove FORM[:NUMBER=VALUE,...]",
    "piston, tilt, power, paraboloid, sphere, conic or cylinder; given ones are fixed (sphere:radius=4000).",
)
ZERNIKE = Opt("--zernike ORDER", "Also Zernike coefficients up to this radial order.", click.IntRange(1, 20))
SLOPES = Opt("--slopes S.npz", "Slopes by `reconstruct --slopes`, for slope error and noise.")
NOMINAL = Opt("--nominal FILE", "Remove this surface (.npz, .tif, .stl, .ply; mm) after a rigid best fit.")
LINES = Opt("--profile x|y|X0,Y0,X1,Y1", "Also rms and PV of the residual along a line (mm).")
PROFILES = Opt("--profiles FILE.csv", "Also write the points of the profiles (default: along x and y).", CSV)
PSD = Rare("--psd FILE.csv", "Also write the power spectral density of the residual along x and y.", CSV)
OUT = Opt("--out R.npz", "Also write x, y, residual, slope_x, slope_y (mm, mm per mm).", OutputFile(".npz"))


@program("form", SAMPLE)
def command(
    source: Annotated[Path, Arg("H.npz")],
    form: Annotated[str, REMOVE] = "sphere",
    nominal: Annotated[Path | None, NOMINAL] = None,
    order: Annotated[int | None, ZERNIKE] = None,
    slopes_path: Annotated[Path | None, SLOPES] = None,
    lines: Annotated[tuple[str, ...], LINES] = (),
    profiles_path: Annotated[Path | None, PROFILES] = None,
    psd_path: Annotated[Path | None, PSD] = None,
    out: Annotated[Path | None, OUT] = None,
    json_path: Json = None,
) -> None:
    """Fit a form to a height map, and measure the residual.

    All good pixels have equal weight, but for their outermost ring, which is left out. A concave mirror has
    a radius above 0. Sigmas include the noise of the frames and the errors of the rig.
    """
    height = ol.reconstruct.HeightMap.load(source)
    slopes = None if slopes_path is None else ol.reconstruct.SlopeMap.load(slopes_path)
    with blame(source):
        if nominal is None:
            fit = ol.metrology.fit_form(height, form, slopes)
        else:
            fit = ol.metrology.fit_nominal(height, ol.metrology.load_nominal(nominal), str(nominal))
        terms = None if order is None else ol.metrology.fit_zernike(height, order, slopes)
        asked = lines or (("x", "y") if profiles_path is not None else ())
        profiles = {line: ol.metrology.profile_of(fit, line) for line in asked}
        axes = () if psd_path is None else ("x", "y")
        spectra = {axis: ol.metrology.spectrum(fit.grid(), axis) for axis in axes}
    numbers = fit.to_dict()
    if profiles:
        numbers["profiles"] = {name: {"rms_mm": one.rms, "pv_mm": one.pv} for name, one in profiles.items()}
    if terms is not None:
        numbers["zernike"] = {"radius_mm": terms.radius, "coefficients_mm": terms.numbers.to_dict()}
    with ol.files.together():
        if profiles_path is not None:
            points = [(name, *row) for name, one in profiles.items() for row in _points(one)]
            ol.files.write_rows(profiles_path, ("line", "s_mm", "x_mm", "y_mm", "z_mm"), points)
        if psd_path is not None:
            points = [(name, *row) for name, one in spectra.items() for row in _points(one)]
            ol.files.write_rows(psd_path, ("axis", "frequency_per_mm", "density_mm3"), points)
        if out is not None:
            names = ("x", "y", "residual", "slope_x", "slope_y")
            ol.files.save_arrays(out, {name: getattr(fit, name) for name in names})
        write_json(json_path, numbers)
    held = "".join(f", {name} = {value:g} given" for name, value in fit.held.items())
    middle = f"x, y from the middle ({fit.middle[0]:.6g}, {fit.middle[1]:.6g}) mm"
    _fitted(f"Form of {source}: {fit.form}{held}; {middle}", fit.numbers)
    if terms is not None:
        title = f"Zernike coefficients, um rms over a circle of radius {terms.radius:.6g} mm"
        _fitted(title, terms.numbers, 1e3)
    along_x, along_y = (number(1e6 * slope) for slope in fit.slope_rms)
    residual = {
        "heights": f"{length(fit.rms)} rms, {length(fit.pv)} from valley to peak",
        "slope error": f"{along_x} urad rms along x, {along_y} urad along y",
        "left out": "the outermost ring of good pixels, whose centres may see no mirror",
    }
    table("Residual", residual)
    if profiles:
        rows = {
            name: f"{length(one.rms)} rms, {length(one.pv)} from valley to peak, {one.s[-1]:.4g} mm long"
            for name, one in profiles.items()
        }
        table("Profiles of the residual", rows)


def _points(record: "ol.metrology.Profile | ol.metrology.Spectrum") -> Iterator[tuple[float, ...]]:
    """The record's arrays point by point."""
    return zip(*(getattr(record, field.name).tolist() for field in fields(record)), strict=True)


def _fitted(title: str, numbers: "ol.metrology.Numbers", factor: float = 1.0) -> None:
    """Parameters with sigma and its parts; a dash where one is unknown."""
    rows = [
        [name, quantity(factor * each["value"], "", factor * each["sigma"])]
        + ["-" if each[key] != each[key] else f"{factor * each[key]:.2g}" for key in ("noise", "rig")]
        for name, each in numbers.to_dict().items()
    ]
    grid(title, ("number", "value ± sigma", "noise", "rig"), rows)
