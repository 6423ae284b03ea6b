"""`optolever form`: a height map without its form: radius, residual, slope error, Zernike coefficients."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

import click

import optolever as ol
from optolever import InputError
from optolever.quantities import quantity

from .arguments import Arg, Opt, Rare, program
from .options import Json, blame
from .outputs import OutputFile
from .show import grid, length, number, table, write_json

if TYPE_CHECKING:
    from collections.abc import Iterator


__all__ = ["command"]

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
"""


class Ends(NamedTuple):
    """Ends of a profile (x, y), mm."""

    start: tuple[float, float]
    end: tuple[float, float]


class Line(click.ParamType[Any]):
    """x, y, or the ends of a line."""

    name = "x|y|X0,Y0,X1,Y1"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        if value in ("x", "y"):
            return value
        try:
            x0, y0, x1, y1 = (float(part) for part in str(value).split(","))
        except ValueError:
            self.fail(f"{value!r} is neither x nor y nor X0,Y0,X1,Y1 (mm)", param, ctx)
        return Ends((x0, y0), (x1, y1))


CSV = OutputFile(".csv")
REMOVE = Opt(
    "--remove FORM[:NUMBER=VALUE,...]",
    "piston, tilt, power, paraboloid, sphere, conic or cylinder; given ones are fixed (sphere:radius=4000).",
)
ZERNIKE = Opt("--zernike ORDER", "Also Zernike coefficients up to this radial order.", click.IntRange(1, 20))
SLOPES = Opt("--slopes S.npz", "Slopes by `reconstruct --slopes`, for slope error and noise.")
NOMINAL = Opt("--nominal FILE", "Remove this surface (.npz, .tif, .stl, .ply; mm) after a rigid best fit.")
LINES = Opt("--profile x|y|X0,Y0,X1,Y1", "Also rms and PV of the residual along a line (mm).", Line())
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
    lines: Annotated[tuple["Ends | str", ...], LINES] = (),
    profiles_path: Annotated[Path | None, PROFILES] = None,
    psd_path: Annotated[Path | None, PSD] = None,
    out: Annotated[Path | None, OUT] = None,
    json_path: Json = None,
) -> None:
    """Fit a form to a height map, and measure the residual.

    All good pixels have equal weight. A concave mirror has a radius above 0. Sigmas include the noise of the
    frames and the errors of the rig.
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
        profiles = _profiles(fit, asked)
        spectra = {} if psd_path is None else _spectra(fit)
    with ol.files.together():
        if profiles_path is not None:
            points = [(name, *row) for name, one in profiles.items() for row in _columns(one)]
            ol.files.write_rows(profiles_path, ("line", "s_mm", "x_mm", "y_mm", "z_mm"), points)
        if psd_path is not None:
            points = [(name, *row) for name, one in spectra.items() for row in _columns(one)]
            ol.files.write_rows(psd_path, ("axis", "frequency_per_mm", "density_mm3"), points)
        if out is not None:
            names = ("x", "y", "residual", "slope_x", "slope_y")
            ol.files.save_arrays(out, {name: getattr(fit, name) for name in names})
        write_json(json_path, _numbers(fit, terms, profiles))
    _show(source, fit, terms)
    if profiles:
        table("Profiles of the residual", {name: _both(one) for name, one in profiles.items()})


def _profiles(
    fit: "ol.metrology.FormFit", lines: "tuple[Ends | str, ...]"
) -> "dict[str, ol.metrology.Profile]":
    """Profiles by the line's name; x and y pass through the middle of the known part."""
    import numpy as np

    if not lines:
        return {}
    grid, found = fit.grid(), {}
    known = np.isfinite(grid.z)
    spans = [
        (at[known.any(axis=axis)][0], at[known.any(axis=axis)][-1])
        for axis, at in enumerate((grid.x, grid.y))
    ]
    (x0, x1), (y0, y1) = spans
    middle = fit.middle
    for line in lines:
        if isinstance(line, Ends):
            ends = line
        elif line == "x":
            ends = Ends((x0, middle[1]), (x1, middle[1]))
        else:
            ends = Ends((middle[0], y0), (middle[0], y1))
        name = line if isinstance(line, str) else ",".join(f"{value:g}" for end in line for value in end)
        found[name] = ol.metrology.profile(grid, ends.start, ends.end)
        if not np.isfinite(found[name].rms):
            part = f"x {x0:.4g} to {x1:.4g}, y {y0:.4g} to {y1:.4g} mm"
            raise InputError(f"--profile {name}: meets no height, must lie in {part}")
    return found


def _spectra(fit: "ol.metrology.FormFit") -> "dict[str, ol.metrology.Spectrum]":

    grid = fit.grid()
    return {axis: ol.metrology.spectrum(grid, axis) for axis in ("x", "y")}


def _columns(record: "ol.metrology.Profile | ol.metrology.Spectrum") -> "Iterator[tuple[float, ...]]":
    """The record's arrays point by point."""
    from dataclasses import fields

    arrays = [getattr(record, field.name).tolist() for field in fields(record)]
    return zip(*arrays, strict=True)


def _both(one: "ol.metrology.Profile") -> str:
    return f"{length(one.rms)} rms, {length(one.pv)} from valley to peak, {one.s[-1]:.4g} mm long"


def _numbers(
    fit: "ol.metrology.FormFit",
    terms: "ol.metrology.ZernikeFit | None",
    profiles: "dict[str, ol.metrology.Profile]",
) -> dict[str, Any]:
    numbers: dict[str, Any] = {
        "form": fit.form,
        "numbers": fit.numbers.to_dict(),
        "held": fit.held,
        "middle_mm": fit.middle,
        "rms_mm": fit.rms,
        "pv_mm": fit.pv,
        "slope_rms": fit.slope_rms,
    }
    if profiles:
        numbers["profiles"] = {name: {"rms_mm": one.rms, "pv_mm": one.pv} for name, one in profiles.items()}
    if terms is not None:
        numbers["zernike"] = {"radius_mm": terms.radius, "coefficients_mm": terms.numbers.to_dict()}
    return numbers


def _show(source: Path, fit: "ol.metrology.FormFit", terms: "ol.metrology.ZernikeFit | None") -> None:
    header = ("number", "value ± sigma", "noise", "rig")

    def rows(numbers: dict[str, dict[str, float]], factor: float = 1.0) -> list[list[str]]:
        return [
            [
                name,
                quantity(factor * each["value"], "", factor * each["sigma"]),
                *(_two(factor * each[key]) for key in header[2:]),
            ]
            for name, each in numbers.items()
        ]

    held = "".join(f", {name} = {value:g} given" for name, value in fit.held.items())
    title = (
        f"Form of {source}: {fit.form}{held}; x, y from the middle ({fit.middle[0]:.6g}, {fit.middle[1]:.6g})"
    )
    grid(f"{title} mm", header, rows(fit.numbers.to_dict()))
    if terms is not None:
        title = f"Zernike coefficients, um rms over a circle of radius {terms.radius:.6g} mm"
        grid(title, header, rows(terms.numbers.to_dict(), 1e3))
    along_x, along_y = (number(1e6 * slope) for slope in fit.slope_rms)
    table(
        "Residual",
        {
            "heights": f"{length(fit.rms)} rms, {length(fit.pv)} from valley to peak",
            "slope error": f"{along_x} urad rms along x, {along_y} urad along y",
        },
    )


def _two(sigma: float) -> str:
    """Two significant digits; a dash if unknown."""
    return "-" if sigma != sigma else f"{sigma:.2g}"
