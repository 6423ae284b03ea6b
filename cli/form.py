"""`optolever form`: a height map without its form: radius, residual, slope error, Zernike coefficients."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from .options import FILE, blame, json_option, sample
from .outputs import OutputFile, Program
from .show import grid, length, number, table, write_json

if TYPE_CHECKING:
    from optolever.metrology import FormFit, ZernikeFit

__all__ = ["command"]

SAMPLE = """
$ optolever form h.npz --remove sphere
Form of h.npz: sphere; x, y from the middle (150.021, 150) mm
number    value         sigma    noise    rig
vertex_x  -0.02287867   6.3e-05  6.3e-05  0
vertex_y  0.001375273   6.5e-05  6.5e-05  0
vertex_z  0.0004064822  -        -        0
radius    4000.596      0.0023   0.0023   0
Residual
  heights      4.6e+02 nm rms, 3.6 um from valley to peak
  slope error  29.1 urad rms along x, 29.11 urad along y
"""


@click.command("form", cls=Program, epilog=sample(SAMPLE))
@click.argument("source", type=FILE, metavar="H.npz")
@click.option(
    "--remove",
    "form",
    default="sphere",
    show_default=True,
    metavar="FORM[:NUMBER=VALUE,...]",
    help="piston, tilt, power, paraboloid, sphere, conic or cylinder; numbers that are given are held, such "
    "as sphere:radius=4000.",
)
@click.option(
    "--zernike",
    "order",
    type=click.IntRange(min=1, max=20),
    metavar="ORDER",
    help="Also Zernike coefficients up to this radial order, over the circle that holds the good pixels.",
)
@click.option(
    "--slopes",
    "slopes_path",
    type=FILE,
    metavar="S.npz",
    help="Slopes that `reconstruct --slopes` wrote: slope error and noise from them, not from differences.",
)
@click.option(
    "--out",
    type=OutputFile(".npz"),
    metavar="R.npz",
    help="Gets x, y, residual, slope_x, slope_y (mm, mm per mm).",
)
@json_option
def command(
    source: Path,
    form: str,
    order: int | None,
    slopes_path: Path | None,
    out: Path | None,
    json_path: Path | None,
) -> None:
    """Fit a form to a height map, and measure the residual.

    Every good pixel counts alike. A radius above 0 is that of a concave mirror. Sigmas hold the noise of the
    frames and the errors of the rig.
    """
    from optolever.files import save_arrays, together
    from optolever.metrology import fit_form, fit_zernike
    from optolever.reconstruct import HeightMap, SlopeMap

    height = HeightMap.load(source)
    slopes = None if slopes_path is None else SlopeMap.load(slopes_path)
    with blame(source):
        fit = fit_form(height, form, slopes)
        terms = None if order is None else fit_zernike(height, order, slopes)
    with together():
        if out is not None:
            names = ("x", "y", "residual", "slope_x", "slope_y")
            save_arrays(out, {name: getattr(fit, name) for name in names})
        write_json(json_path, _numbers(fit, terms))
    _show(source, fit, terms)


def _numbers(fit: "FormFit", terms: "ZernikeFit | None") -> dict[str, Any]:
    numbers: dict[str, Any] = {
        "form": fit.form,
        "numbers": fit.numbers.to_dict(),
        "held": fit.held,
        "middle_mm": fit.middle,
        "rms_mm": fit.rms,
        "pv_mm": fit.pv,
        "slope_rms": fit.slope_rms,
    }
    if terms is not None:
        numbers["zernike"] = {"radius_mm": terms.radius, "coefficients_mm": terms.numbers.to_dict()}
    return numbers


def _show(source: Path, fit: "FormFit", terms: "ZernikeFit | None") -> None:
    header = ("number", "value", "sigma", "noise", "rig")

    def rows(numbers: dict[str, dict[str, float]], factor: float = 1.0) -> list[list[str]]:
        return [
            [name, f"{factor * each['value']:.7g}", *(_two(factor * each[key]) for key in header[2:])]
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
    """Two significant digits; a dash where it is not known."""
    return "-" if sigma != sigma else f"{sigma:.2g}"
