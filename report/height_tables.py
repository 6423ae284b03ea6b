"""The numbers and tables of a measurement's page; every number of theirs is also in its file."""

import math
from collections.abc import Mapping, Sequence
from typing import TypeAlias

import numpy as np
from markupsafe import Markup

from optolever.arrays import Floats
from optolever.metrology import FormFit, ZernikeFit, in_waves, slope_errors
from optolever.reconstruct import Contact
from optolever.samples import Measurement, Study, rms

from .flag_table import FlagRow
from .page import Figures, Table

__all__ = ["cards", "contacts_table", "differences_table", "flags_table", "form_table", "terms_table"]

#: Id, name, value and explanation of a number.
Card: TypeAlias = tuple[str, str, str, str]
#: Units of a form's parameters, those without one aside.
_UNITS = {"radius": "mm", "focal": "mm", "piston": "mm", "axis_deg": "°", "power": "1/mm"}


def cards(study: Study, figures: Figures) -> list[Card]:
    """The numbers that come first."""
    given, height, show = study.given, study.given.height, figures.show
    good = height.good

    def median(values: Floats) -> float:
        return float(np.median(values[good])) if good.any() else math.nan

    found = _contact_cards(study.contacts[0], figures) if study.contacts else []
    found += _error_cards(given.metrics, figures) if given.metrics else []
    if study.fit is None and not study.contacts:
        z = height.z[good] if good.any() else np.array([math.nan])
        deepest, least = show("largest z", z.max(), "mm"), show("smallest z", z.min(), "mm")
        found.append(("depth", "Largest z", deepest, Markup("smallest {}").format(least)))
    if study.fit is not None:
        found += _form_cards(study.fit, figures, given.waves)
    noise = show("sigma by noise", median(height.sigma), "mm")
    rig = Markup("")
    if height.modes is not None:
        rig = show("sigma by the rig", median(height.calibration_sigma), "mm")
    if study.deviation is not None:
        known = good & np.isfinite(study.deviation.z)
        value = show("sigma of the deviation", float(np.median(study.deviation.total_sigma[known])), "mm")
        says = Markup("of the good pixels; of a height {} by noise").format(noise)
        says += Markup(", {} by the rig").format(rig) if rig else Markup("")
        found.append(("deviation_sigma", "Standard deviation of the deviation, median", value, says))
    else:
        found.append(("noise_mm", "Standard deviation by noise, median", noise, "of the good pixels"))
        if rig:
            why = "of the good pixels; moves the whole map at once"
            found.append(("rig_mm", "Standard deviation by the rig, median", rig, why))
    if not given.metrics:
        share = show("good pixels", good.mean(), "%")
        found.append(("good_share", "Pixels with a height", share, "of all camera pixels"))
    return found


def _contact_cards(contact: Contact, figures: Figures) -> list[Card]:
    """Depth, place and force of the deepest contact."""
    show = figures.show
    x, y = (show(f"contact 1 {name}", getattr(contact, name), "mm", contact.position_sigma) for name in "xy")
    depth = show("contact 1 depth", contact.depth, "mm", contact.depth_sigma)
    found: list[Card] = [
        ("depth", "Depth of the contact", depth, Markup("over its surroundings, at x {}, y {}").format(x, y))
    ]
    if contact.force is not None:
        force = show("contact 1 force", contact.force, "N", contact.force_sigma or math.nan)
        found.append(("force", "Force", force, "normal to the mirror, by the scene's [layer]"))
    return found


def _form_cards(fit: FormFit, figures: Figures, waves: float | None) -> list[Card]:
    show, found = figures.show, list[Card]()
    says = f"of the height less the {fit.form}, about its mean"
    sigmas = fit.rms_sigmas(fit.rms)
    value = show("deviation rms", fit.rms, "mm", math.hypot(*sigmas))
    if math.isfinite(sigmas[0]):
        less = show("deviation rms less noise", fit.rms_less_noise, "mm", sigmas[0])
        says = Markup("{}; without its noise, ± by noise alone, {}").format(says, less)
    found.append(("deviation_rms", "Deviation, rms", value, says))
    value, robust = (
        show(f"deviation {name}", each, "mm", math.hypot(*fit.pv_sigmas))
        for name, each in (("pv", fit.pv), ("pvr", fit.pvr))
    )
    says = Markup("of good pixels; PVr {}").format(robust)
    found.append(("deviation_pv", "Deviation, peak to valley", value, says))
    if waves is not None:
        rms, pv = (
            show(f"wavefront {name}", in_waves(each, waves), "waves", in_waves(math.hypot(*by), waves))
            for name, each, by in (("rms", fit.rms, sigmas), ("pv", fit.pv, fit.pv_sigmas))
        )
        says = Markup("peak to valley {}; of {} nm, twice the deviation").format(pv, f"{waves:g}")
        found.append(("wavefront", "Reflected wavefront, rms", rms, says))
    for name, number, sigma in zip(fit.numbers.names, fit.numbers.values, fit.numbers.sigma, strict=True):
        if name in ("radius", "focal"):
            value, says = show(f"{fit.form} {name}", number, "mm", float(sigma)), "above 0 where concave"
            if abs(number) < 3 * sigma:
                value, says = Markup("flat within its sigma"), value
            found.append((name, f"{name} of the {fit.form}".capitalize(), value, says))
    along = dict(zip("xy", slope_errors(fit), strict=True))
    along_x, along_y = (
        show(f"slope error {axis}", 1e6 * one.known[0], "µrad", 1e6 * one.sigma)
        for axis, one in along.items()
    )
    noise = "less noise" if math.isfinite(along["x"].sigma) else "noise unknown"
    says = Markup("along x, less the form's, {}; along y {}").format(noise, along_y)
    found.append(("slope_error", "Slope error, rms", along_x, says))
    return found


def _error_cards(m: Mapping[str, float], figures: Figures) -> list[Card]:
    """Errors against the truth."""
    show = figures.show
    error = show("error rms", m["height_rms_mm"], "mm")
    worst = show("error max over peak", m["height_max_rel"])
    over_peak = show("error rms over peak", m["height_rms_rel"])
    share = show("unflagged of visible", m["unflagged_share"], "%")
    ratio, *axes = (
        show(f"error over sigma, {name}", m[f"sigma_ratio_{key}"])
        for name, key in (("height", "total"), ("u", "u"), ("v", "v"))
    )
    sigma, middle = (
        show(name, m[key], "mm")
        for name, key in (("sigma rms", "height_sigma_mm"), ("error median", "height_median_mm"))
    )
    compared = Markup(
        "{} of the largest height; by sigma {}; median {}; largest, over that height: {}"
    ).format(over_peak, sigma, middle, worst)
    says = Markup("1 where error bars are true; u {}, v {}").format(*axes)
    seen = "of the pixels that see the pattern in the mirror"
    return [
        ("height_rms_rel", "Height error, rms", error, compared),
        ("unflagged_share", "Visible pixels with a height", share, seen),
        ("sigma_ratio_height", "Error over sigma, height", ratio, says),
    ]


def form_table(fit: FormFit, figures: Figures) -> Table:
    """Numbers of the form."""
    rows: list[list[str]] = []
    for name, each in fit.numbers.to_dict().items():
        label, unit = f"{fit.form} {name}", "mm" if name.startswith("vertex") else _UNITS.get(name, "")
        rows.append([name, figures.show(label, each["value"], unit, each["noise"], each["rig"])])
    rows += [[name, f"{value:g}, given"] for name, value in fit.held.items()]
    return Table("form-table", ("number", "value ± sigma"), rows)


def terms_table(terms: ZernikeFit, figures: Figures) -> Table:
    """Coefficients of Zernike terms."""
    listed = terms.listed()
    numbers = zip(listed.names, listed.values, listed.noise, listed.rig, strict=True)
    rows = [[name, figures.show(name, value, "mm", *parts)] for name, value, *parts in numbers]
    return Table("zernike-table", ("term", "coefficient ± sigma"), rows)


def contacts_table(contacts: Sequence[Contact], figures: Figures) -> Table:
    """A row per contact; force and pressure where the layer is known."""
    known = any(each.force is not None for each in contacts)
    heads = ("contact", "", "depth", "area", "volume", "x", "y", *(("force", "pressure") if known else ()))
    rows = []
    for n, each in enumerate(contacts, 1):
        numbers: list[tuple[str, float, str, float]] = [
            ("depth", each.depth, "mm", each.depth_sigma),
            ("area", each.area, "mm²", each.area_sigma),
            ("volume", each.volume, "mm³", each.volume_sigma),
            ("x", each.x, "mm", each.position_sigma),
            ("y", each.y, "mm", each.position_sigma),
        ]
        if each.force is not None and each.force_sigma is not None and each.pressure is not None:
            numbers += [("force", each.force, "N", each.force_sigma)]
            numbers += [("pressure", each.pressure, "N/mm²", math.nan)]
        words = ("lower bounds", each.force_at_least), ("hole", each.hole)
        bounds = [word for word, known in words if known]
        shown = (figures.show(f"contact {n} {one[0]}", *one[1:]) for one in numbers)
        rows.append([str(n), ", ".join(bounds), *shown])
    return Table("contact-table", heads, rows, texts=2)


def differences_table(given: Measurement, figures: Figures) -> Table:
    """A row per map that is subtracted."""
    rows = []
    for name, other in given.less.items():
        change, sigma = given.height.difference(other)
        both = given.height.good & other.good & np.isfinite(change)
        moved, spread = (part[both] if both.any() else np.array([math.nan]) for part in (change, sigma))
        numbers = (
            ("mean", moved.mean(), "mm"),
            ("rms", rms(moved), "mm"),
            ("largest", moved.max(), "mm"),
            ("smallest", moved.min(), "mm"),
            ("sigma", float(np.median(spread)), "mm"),
            ("beyond 3 sigma", float(np.mean(np.abs(moved) > 3 * spread)) if both.any() else math.nan, "%"),
        )
        label = f"{given.name} − {name}"
        rows.append(
            [label, *(figures.show(f"{label}, {each}", value, unit) for each, value, unit in numbers)]
        )
    heads = ("difference", "mean", "rms", "largest", "smallest", "sigma, median", "pixels beyond 3 sigma")
    return Table("difference-table", heads, rows)


def flags_table(rows: Sequence[FlagRow], areas: bool, figures: Figures) -> Table:
    """Every pixel by its first reason, and the sum."""

    def line(name: str, head: str, text: str, pixels: str, area: float, share: float) -> list[str]:
        cells = [figures.show(f"{name}, area", area, "mm²")] if areas else []
        return [head, text, pixels, *cells, figures.show(f"{name}, share", share, "%")]

    cells = []
    for row in rows:
        swatch = Markup('<span class="swatch" style="background:{}"></span> {}').format(row.colour, row.name)
        pixels = f"{row.count:,}" if row.bit >= 0 else ""
        cells.append(line(f"flag {row.name}", swatch, row.meaning, pixels, row.area, row.share))
    pixels, area, share = (sum(getattr(row, part) for row in rows) for part in ("count", "area", "share"))
    cells.append(line("sum", "the mirror" if areas else "the image", "", f"{pixels:,}", area, share))
    heads = ("first reason", "meaning", "pixels", *(("area",) if areas else ()), "share")
    return Table("flag-counts", heads, cells, texts=2, kinds=[*[""] * len(rows), "best"])
