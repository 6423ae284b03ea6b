"""`optolever form`: a height map without its form: radius, residual, slope error, Zernike coefficients.

$ optolever form measured/h.npz --remove sphere
Form of measured/h.npz: sphere; x, y from the middle (77.3122, 55.4159) mm
number    value ± noise    ± rig
vertex_x  −0.880 ± 0.46    1.7
vertex_y  3.27 ± 0.59      2.6
vertex_z  0.002410         0.0013
radius    −990000 ± 11000  440000
Residual
  heights      0.5571 µm rms ± 5.9 nm noise, ± 17 nm rig; without its noise
               0.5545 µm
  PV           2.89 µm ± 120 nm noise, ± 180 nm rig; PVr 2.803 µm
  slope error  39.47 µrad rms along x ± 0.41 µrad noise, ± 0.97 µrad rig; 30.48
               µrad along y ± 0.47 µrad noise, ± 0.95 µrad rig; with its noise
               44.84 µrad, 40.49 µrad
  left out     the outermost ring of good pixels, whose centres may see no
               mirror
"""

from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, fields
from math import isfinite, isinf, radians
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import optolever as ol
from optolever import InputError
from optolever.numbers import listed, written
from optolever.quantities import by_parts, quantity, two_digits

from .arguments import ABOVE_0, Arg, Opt, Rare, program
from .options import Json, blame
from .outputs import HEIGHT_SUFFIXES, OutputFile
from .printing import grid, length, print_notices, table, write_json

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray


CSV = OutputFile(".csv")
REMOVE = Opt(
    "--remove FORM[:NUMBER=VALUE,...]",
    "piston, tilt, power, paraboloid, sphere (default), conic, asphere, off-axis or cylinder; given numbers "
    "(mm) are fixed (sphere:radius=4000, off-axis:distance=100).",
)
ZERNIKE = Opt(
    "--zernike ORDER[:NAME=VALUE,...]",
    "Also Zernike coefficients up to this radial order; index=fringe (else ansi): order of the terms; "
    "norm=amplitude: at the circle's edge (else rms over the circle).",
)
SLOPES = Opt("--slopes S.npz", "Slopes by `reconstruct --slopes`, for slope error and noise.")
NOMINAL = Opt(
    "--nominal FILE", "Remove this surface (.npz, a grid or mesh that export writes) after a rigid best fit."
)
LINES = Opt("--profile x|y|X0,Y0,X1,Y1", "Also rms and PV of the residual along a line (mm).")
PROFILES = Opt("--profiles FILE.csv", "Also write the points of the profiles (default: along x and y).", CSV)
PSD = Rare("--psd FILE.csv", "Also write the power spectral density of the residual along x and y.", CSV)
OUT = Opt(
    "--out R.npz",
    "Also write the residual, in the formats of `export`; of several maps the mean, in .npz with each map "
    "less it.",
    OutputFile(*HEIGHT_SUFFIXES, bare=False),
)


APERTURE = Opt(
    "--aperture SHAPE|MASK.png",
    "Inside circle (inscribed), circle:radius=R,x=X,y=Y, ellipse:a=A,b=B, rectangle:width=W,height=H "
    "or a mask's white; again for what all contain.",
)
HIGH = Opt("--highpass MM", "Keep wavelengths below this cutoff (Gaussian, ISO 16610-61).", ABOVE_0)
LOW = Opt("--lowpass MM", "Keep wavelengths above this cutoff (Gaussian, ISO 16610-61).", ABOVE_0)
LIMIT = Opt(
    "--limit NAME=LIMIT",
    "rms, pv or pvr (rms=50nm), slope_x or slope_y (20urad): pass or fail by 2 sigma, "
    "undecided where sigma is unknown; fail: exit code 1.",
)
WAVES = Opt(
    "--waves NM", "Also the reflected wavefront (twice the surface) in waves of this length.", ABOVE_0
)
TURNS = Opt(
    "--rotations DEG,DEG,...",
    "Of several maps: the mirror's turns, from x to y; separates the mirror's part from the rig's.",
)


@program("form", __doc__)
def command(
    sources: Annotated[tuple[Path, ...], Arg("H.npz...")],
    form: Annotated[str | None, REMOVE] = None,
    nominal: Annotated[Path | None, NOMINAL] = None,
    apertures: Annotated[tuple[str, ...], APERTURE] = (),
    highpass: Annotated[float | None, HIGH] = None,
    lowpass: Annotated[float | None, LOW] = None,
    zernike: Annotated[str | None, ZERNIKE] = None,
    limits: Annotated[tuple[str, ...], LIMIT] = (),
    waves: Annotated[float | None, WAVES] = None,
    turns: Annotated[str | None, TURNS] = None,
    slopes_path: Annotated[Path | None, SLOPES] = None,
    lines: Annotated[tuple[str, ...], LINES] = (),
    profiles_path: Annotated[Path | None, PROFILES] = None,
    psd_path: Annotated[Path | None, PSD] = None,
    out: Annotated[Path | None, OUT] = None,
    json_path: Json = None,
) -> int:
    """Fit a form to a height map, and measure the residual.

    All good pixels but their outermost ring have equal weight. A concave mirror has a radius above 0. Sigmas
    include the noise of the frames and the errors of the rig. Zernike terms describe the residual over the
    aperture's circle, else the inscribed one. H.npz may also be a grid of another program (.x3p, .dat, .datx,
    .wft, .sdf, .csv, .npy; .tif with floats in mm). Several maps of one mirror: their mean and differences.
    """
    order, index, norm = _zernike(zernike)
    _require_once(limits)
    shape = _Shape.asked(form, nominal, apertures, highpass, lowpass)
    if len(sources) > 1:
        alone: dict[str, object] = {"--slopes": slopes_path, "--zernike": order, "--profile": lines}
        alone |= {"--limit": limits, "--profiles": profiles_path, "--psd": psd_path, "--waves": waves}
        _require_none(alone, len(sources))
        return _runs(sources, shape, turns, out, json_path)
    if turns is not None:
        raise InputError(f"--rotations {turns}: is of several maps; name each, with its turn")
    (source,) = sources
    height = ol.metrology.load_measured(source)
    slopes = None if slopes_path is None else ol.reconstruct.SlopeMap.load(slopes_path)
    with blame(source):
        fit, inside = shape.fitted(height, slopes)
        terms = None if order is None else _terms(fit, height, order, apertures, slopes)
        asked = lines or (("x", "y") if profiles_path is not None else ())
        profiles = {line: ol.metrology.profile_of(fit, line) for line in asked}
        spectra = {axis: ol.metrology.spectrum(fit.grid(), axis) for axis in ("xy" if psd_path else "")}
    along_x, along_y = ol.metrology.slope_errors(fit)
    known = {"rms": (fit.rms, *fit.rms_sigmas(fit.rms)), "pv": (fit.pv, *fit.pv_sigmas)}
    known |= {"pvr": (fit.pvr, *fit.pv_sigmas), "slope_x": along_x.known, "slope_y": along_y.known}
    if inside is not None and (inside | ~height.good).all():
        print_notices([f"--aperture {' '.join(apertures)}: contains every good pixel, nothing is left out"])
    verdicts = [ol.metrology.judge(limit, known) for limit in limits]
    numbers = _numbers(fit, along_x, along_y, waves, profiles)
    if verdicts:
        numbers["limits"] = {one.name: asdict(one) for one in verdicts}
    if terms is not None:
        coefficients = terms.listed(index, norm == "amplitude").to_dict()
        numbers["zernike"] = {"radius_mm": terms.radius, "coefficients_mm": coefficients, "norm": norm}
    with ol.files.together():
        _write_points(profiles_path, ("line", "s_mm", "x_mm", "y_mm", "z_mm"), profiles)
        _write_points(psd_path, ("axis", "frequency_per_mm", "density_mm3"), spectra)
        if out is not None:
            fit.export(out, height)
        write_json(json_path, numbers)
    held = "".join(f", {name} = {value:g} given" for name, value in fit.held.items())
    middle = "x, y from the middle ({:.6g}, {:.6g}) mm".format(*fit.middle)
    _fitted(f"Form of {source}: {fit.form}{held}; {middle}", fit.numbers)
    if terms is not None:
        what = "amplitude" if norm == "amplitude" else "rms (ISO 14999-2)"
        circle = "circle of radius {:.6g} mm about ({:.6g}, {:.6g}) mm".format(terms.radius, *terms.middle)
        title = f"Zernike terms of the residual, µm, {what}, {circle}"
        _fitted(title, terms.listed(index, norm == "amplitude"), 1e3)
    _residual(fit, known, along_x, along_y, waves, shape, height.diagnostics.method == ol.metrology.FOREIGN)
    if profiles:
        table("Profiles of the residual", {name: _profile(one) for name, one in profiles.items()})
    if verdicts:
        table("Limits", {one.name: f"{one.verdict}: {_against(one, known[one.name])}" for one in verdicts})
    return 1 if any(one.verdict == "fail" for one in verdicts) else 0


def _zernike(text: str | None) -> tuple[int | None, str, str]:
    """Radial order, order of the terms and norm of --zernike."""
    if text is None:
        return None, "ansi", "rms"
    order, _, more = text.partition(":")
    known = {"index": ("ansi", "fringe"), "norm": ("rms", "amplitude")}
    form = ", ".join(f"{name}={'|'.join(names)}" for name, names in known.items())
    given = {name: names[0] for name, names in known.items()} | written("--zernike", more, form, known)
    if any(value not in known[name] for name, value in given.items()):
        raise InputError(f"--zernike {text}: must have {form}")
    if not order.isdecimal() or not 1 <= int(order) <= 20:
        raise InputError(f"--zernike {text}: the order is {order!r}, must be 1 to 20")
    return int(order), given["index"], given["norm"]


def _terms(
    fit: "ol.metrology.FormFit",
    height: "ol.reconstruct.HeightMap",
    order: int,
    apertures: tuple[str, ...],
    slopes: "ol.reconstruct.SlopeMap | None",
) -> "ol.metrology.ZernikeFit":
    """Zernike terms of the residual over the aperture's circle, else the inscribed one."""
    centre, radius = ol.metrology.aperture_circle(apertures, height.x, height.y, height.good)
    return ol.metrology.fit_zernike(fit.deviation(height), order, slopes, radius, None, fit, centre)


def _profile(one: "ol.metrology.Profile") -> str:
    return f"{length(one.rms)} rms, {length(one.pv)} from valley to peak, {one.s[-1]:.4g} mm long"


def _write_points(
    path: Path | None,
    heads: tuple[str, ...],
    curves: "Mapping[str, ol.metrology.Profile] | Mapping[str, ol.metrology.Spectrum]",
) -> None:
    """The points of curves by name, into a file that is asked for."""
    if path is not None:
        rows = [(name, *row) for name, one in curves.items() for row in _points(one)]
        ol.files.write_rows(path, heads, rows)


def _require_once(limits: tuple[str, ...]) -> None:
    names = [limit.partition("=")[0] for limit in limits]
    for name in names:
        if names.count(name) > 1:
            raise InputError(f"--limit {name}: has {names.count(name)} limits, must be one")


def _require_none(options: dict[str, object], maps: int) -> None:
    for option, value in options.items():
        if value:
            raise InputError(f"{option}: is of one map, not of {maps}; leave it out")


def _numbers(
    fit: "ol.metrology.FormFit",
    along_x: "ol.metrology.SlopeError",
    along_y: "ol.metrology.SlopeError",
    waves: float | None,
    profiles: "dict[str, ol.metrology.Profile]",
) -> dict[str, Any]:
    """Of the fit, for --json."""
    numbers: dict[str, Any] = fit.to_dict()
    if waves is not None:
        known = {"rms": fit.rms, "pv": fit.pv, "pvr": fit.pvr}
        wavefront = {name: ol.metrology.in_waves(value, waves) for name, value in known.items()}
        numbers["waves"] = {"length_nm": waves} | wavefront
    numbers |= {
        "slope_rms_less_noise": [along_x.less_noise, along_y.less_noise],
        "slope_rms_sigma": [along_x.sigma, along_y.sigma],
    }
    if profiles:
        numbers["profiles"] = {name: {"rms_mm": one.rms, "pv_mm": one.pv} for name, one in profiles.items()}
    return numbers


def _residual(
    fit: "ol.metrology.FormFit",
    known: "Mapping[str, tuple[float, float, float]]",
    along_x: "ol.metrology.SlopeError",
    along_y: "ol.metrology.SlopeError",
    waves: float | None,
    shape: "_Shape",
    foreign: bool,
) -> None:
    """Heights, PV, slope errors and the wavefront of the residual."""
    less = quantity(fit.rms_less_noise, "mm", size=fit.rms)
    rms, pv, slope_x, slope_y = (known[name] for name in ("rms", "pv", "slope_x", "slope_y"))
    residual = {
        "heights": by_parts(rms, "mm", "rms")
        + (f"; without its noise {less}" if isfinite(fit.rms_less_noise) else ""),
        "PV": f"{by_parts(pv, 'mm')}; PVr {quantity(fit.pvr, 'mm', size=fit.pv)}",
        "slope error": f"{_slope(slope_x, 'rms along x')}; {_slope(slope_y, 'along y')}",
    }
    if isfinite(along_x.less_noise):
        residual["slope error"] += (
            f"; with its noise {quantity(1e6 * along_x.rms, 'µrad')}, {quantity(1e6 * along_y.rms, 'µrad')}"
        )
    if not foreign:
        residual["left out"] = "the outermost ring of good pixels, whose centres may see no mirror"
    if waves is not None:
        scaled = ([ol.metrology.in_waves(each, waves) for each in one] for one in (rms, pv))
        texts = [by_parts(one, "waves") for one in scaled]
        residual["wavefront"] = f"rms {texts[0]}; PV {texts[1]}; of {waves:g} nm, twice the surface"
    table("Residual" + "".join(f", {text}" for text in shape.texts()), residual)


@dataclass(frozen=True)
class _Shape:
    """What is measured: less which form or surface, where, and which wavelengths."""

    form: str
    nominal: Path | None
    apertures: tuple[str, ...]
    highpass: float | None
    lowpass: float | None

    @classmethod
    def asked(
        cls, form: str | None, nominal: Path | None, apertures: tuple[str, ...],
        highpass: float | None, lowpass: float | None,
    ) -> "_Shape":  # fmt: skip
        """By the options. InputError where two exclude each other."""
        if nominal is not None and form is not None:
            raise InputError(f"--remove {form}: {nominal} is removed already; leave one out")
        if highpass is not None and lowpass is not None and highpass <= lowpass:
            raise InputError(
                f"--highpass {highpass:g}: must be above --lowpass {lowpass:g}, else no wave is left"
            )
        return cls(form or "sphere", nominal, apertures, highpass, lowpass)

    def fitted(
        self, height: "ol.reconstruct.HeightMap", slopes: "ol.reconstruct.SlopeMap | None" = None
    ) -> "tuple[ol.metrology.FormFit, NDArray[np.bool_] | None]":
        """The fit to a map, and its aperture (H, W)."""
        inside = None
        if self.apertures:
            inside = ol.metrology.aperture_mask(self.apertures, height.x, height.y, height.good)
        if self.nominal is None:
            fit = ol.metrology.fit_form(height, self.form, slopes, inside)
            if ":" in self.form and fit.rms > (
                flat := ol.metrology.fit_form(height, "tilt", None, inside).rms
            ):
                left = f"leaves {length(fit.rms)} rms, a plane {length(flat)}"
                print_notices([f"--remove {self.form}: {left}; are its numbers of this mirror, in mm?"])
        else:
            surface = ol.metrology.load_nominal(self.nominal)
            fit = ol.metrology.fit_nominal(height, surface, str(self.nominal), inside, slopes)
        if self.lowpass is not None:
            fit = ol.metrology.gaussian_filter(fit, self.lowpass, "low")
        return fit if self.highpass is None else ol.metrology.gaussian_filter(
            fit, self.highpass, "high"
        ), inside

    def texts(self) -> list[str]:
        """Aperture and filters, for a heading."""
        passes = (("above", self.lowpass), ("below", self.highpass))
        waves = [f"wavelengths {which} {mm:g} mm" for which, mm in passes if mm is not None]
        return [*self.apertures, *waves]


def _runs(
    sources: tuple[Path, ...], shape: _Shape, turns: str | None, out: Path | None, json_path: Path | None
) -> int:
    """Mean and differences of several maps."""
    heights, fits = [ol.metrology.load_measured(source) for source in sources], []
    for source, height in zip(sources, ol.metrology.in_common(heights), strict=True):
        with blame(source):
            fits.append(shape.fitted(height)[0])
    form = "degrees with commas, such as 0,90,180,270"
    angles = None if turns is None else [radians(each) for each in listed("--rotations", turns, form)]
    found = ol.metrology.compare_runs(fits, angles)
    parts = {"mirror" if turns else "mean": found.mirror} | ({"rig": found.rig} if turns else {})
    numbers = {f"{name}_rms_mm": found.rms(z) for name, z in parts.items()}
    paths = [f"{k}: {source}" for k, source in enumerate(sources, 1)]
    left = {path: found.rms(z) for path, z in zip(paths, found.left, strict=True)}
    with ol.files.together():
        if out is not None:
            found.export(out)
        write_json(json_path, numbers | {"noise_mm": found.noise, "left_rms_mm": left})
    rows = {name: f"{length(found.rms(z))} rms" for name, z in parts.items()}
    rows[f"noise of the {next(iter(parts))}"] = length(found.noise)
    rows |= {f"left in {path}": f"{length(rms)} rms" for path, rms in left.items()}
    table(f"{len(sources)} maps less {shape.nominal or shape.form}", rows)
    return 0


def _against(one: "ol.metrology.Verdict", known: tuple[float, float, float]) -> str:
    """A figure and its limit."""
    if one.name.startswith("slope"):
        return f"{_slope(known)}, at most {quantity(1e6 * one.limit, 'µrad')}"
    return f"{by_parts(known, 'mm')}, at most {quantity(one.limit, 'mm')}"


def _slope(known: tuple[float, float, float], what: str = "") -> str:
    return by_parts([1e6 * each for each in known], "µrad", what)


def _points(record: "ol.metrology.Profile | ol.metrology.Spectrum") -> Iterator[tuple[float, ...]]:
    """The record's arrays point by point."""
    return zip(*(getattr(record, field.name).tolist() for field in fields(record)), strict=True)


def _fitted(title: str, numbers: "ol.metrology.Numbers", factor: float = 1.0) -> None:
    """Parameters with standard deviations by noise and by the rig; a dash where one is unknown."""
    rows = []
    for name, each in numbers.to_dict().items():
        value, noise, rig = (factor * each[part] for part in ("value", "noise", "rig"))
        text = "undetermined" if isinf(each["sigma"]) else quantity(value, "", noise)
        rows.append([name, text, two_digits(rig)])
    grid(title, ("number", "value ± noise", "± rig"), rows)
