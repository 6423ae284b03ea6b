"""The tables of a measurement's page; every number of theirs is also in its file."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from markupsafe import Markup

from optolever.metrology import ZernikeFit
from optolever.reconstruct import Contact

from .figures import Figures
from .flag_table import FlagRow
from .measurement import Measurement, Study
from .metrics import height_metrics, rms
from .page import table

__all__ = [
    "budget_table",
    "cards",
    "dents_table",
    "differences_table",
    "flags_table",
    "form_table",
    "terms_table",
]


@dataclass(frozen=True, slots=True)
class _Card:
    id: str
    name: str
    value: Markup
    says: str


def cards(study: Study, figures: Figures) -> list[_Card]:
    """The numbers that come first."""
    given, height, show = study.given, study.given.height, figures.show
    good = height.good
    z, noise, rig = (
        values[good] if good.any() else np.array([np.nan])
        for values in (height.z, height.sigma, height.calibration_sigma)
    )
    cards = [
        _Card(
            "good_share",
            "Pixels with a height",
            show("good pixels", good.mean(), "%"),
            "of all camera pixels",
        )
    ]
    if study.fit is not None:
        fit = study.fit
        radius = [k for k, name in enumerate(fit.numbers.names) if name in ("radius", "focal")]
        for k in radius:
            name, sigma = fit.numbers.names[k], float(fit.numbers.sigma[k])
            value = show(f"{fit.form} {name}", fit.numbers.values[k], "mm", sigma)
            cards.append(
                _Card(name, f"{name} of the {fit.form}".capitalize(), value, "above 0 where concave")
            )
        says = f"of the height less the {fit.form}, about its mean"
        cards.append(_Card("deviation_rms", "Deviation, rms", show("deviation rms", fit.rms, "mm"), says))
        cards.append(
            _Card(
                "deviation_pv",
                "Deviation, peak to valley",
                show("deviation pv", fit.pv, "mm"),
                "of good pixels",
            )
        )
        for axis, slope in zip("xy", fit.slope_rms, strict=True):
            value = show(f"slope error {axis}", 1e6 * slope, "µrad")
            cards.append(_Card(f"slope_{axis}", f"Slope error along {axis}, rms", value, "less the form's"))
    else:
        deepest, least = show("largest z", z.max(), "mm"), show("smallest z", z.min(), "mm")
        cards.append(_Card("depth", "Largest z", deepest, Markup("smallest {}").format(least)))
    if study.deviation is not None:
        spread = float(np.median(study.deviation.total_sigma[good]))
        says = "median of the good pixels; errors of the rig less their part in the form"
        value = show("sigma of the deviation", spread, "mm")
        cards.append(_Card("deviation_sigma", "Standard deviation of the deviation", value, says))
    value = show("sigma by noise", np.median(noise), "mm")
    cards.append(_Card("noise_mm", "Standard deviation by noise", value, "median of the good pixels"))
    if height.modes is not None:
        value = show("sigma by the rig", np.median(rig), "mm")
        says = "median of the good pixels; moves the whole map at once"
        cards.append(_Card("rig_mm", "Standard deviation by the rig", value, says))
    if given.truth is not None and given.correspondence is not None:
        m = height_metrics(given.truth, given.correspondence, height)
        error, worst = (
            show("error rms", m["height_rms_mm"], "mm"),
            show("error max over peak", m["height_max_rel"]),
        )
        return [
            _Card(
                "height_rms_rel",
                "Height error, rms over largest height",
                show("error rms over peak", m["height_rms_rel"]),
                Markup("{} rms; largest, over that height: {}").format(error, worst),
            ),
            _Card(
                "unflagged_share",
                "Visible pixels with a height",
                show("unflagged of visible", m["unflagged_share"], "%"),
                "of the pixels that see the pattern in the mirror",
            ),
            _Card(
                "sigma_ratio_height",
                "Error over sigma, height",
                show("error over sigma, height", m["sigma_ratio_height"]),
                Markup("1 where error bars are true; u {}, v {}").format(
                    show("error over sigma, u", m["sigma_ratio_u"]),
                    show("error over sigma, v", m["sigma_ratio_v"]),
                ),
            ),
            *cards,
        ]
    return cards


def form_table(study: Study, figures: Figures) -> dict[str, Any] | None:
    """Numbers of the form."""
    if study.fit is None:
        return None
    fit, rows = study.fit, []
    for name, each in fit.numbers.to_dict().items():
        unit = {"radius": "mm", "focal": "mm", "piston": "mm", "axis_deg": "°", "power": "1/mm"}.get(name, "")
        unit = "mm" if name.startswith("vertex") else unit
        parts = [
            figures.show(f"{fit.form} {name} {part}", each[part], unit) if np.isfinite(each[part]) else "–"
            for part in ("noise", "rig")
        ]
        rows.append(
            ("", [name, figures.show(f"{fit.form} {name}", each["value"], unit, each["sigma"]), *parts])
        )
    rows += [("", [name, f"{value:g}, given", "", ""]) for name, value in fit.held.items()]
    middle = [figures.show(f"middle {axis}", at, "mm") for axis, at in zip("xy", fit.middle, strict=True)]
    heads = ("number", "value ± sigma", "by noise", "by the rig")
    return {"name": fit.form, "middle": Markup(", ").join(middle), "table": table("form-table", heads, rows)}


def terms_table(terms: ZernikeFit, figures: Figures) -> dict[str, Any]:
    rows = [
        ("", [name, figures.show(name, value, "mm", sigma)])
        for name, value, sigma in zip(
            terms.numbers.names, terms.numbers.values, terms.numbers.sigma, strict=True
        )
    ]
    return {
        "radius": figures.show("radius of the circle", terms.radius, "mm"),
        "table": table("zernike-table", ("term", "coefficient ± sigma"), rows),
    }


def dents_table(dents: tuple[Contact, ...], figures: Figures) -> dict[str, Any]:
    heads = ("dent", "region", "depth", "area", "volume", "centroid x", "centroid y")
    rows = []
    for n, each in enumerate(dents, 1):
        numbers = [
            figures.show(f"dent {n} {name}", value, unit, sigma)
            for name, value, unit, sigma in (
                ("depth", each.depth, "mm", each.depth_sigma),
                ("area", each.area, "mm²", each.area_sigma),
                ("volume", each.volume, "mm³", each.volume_sigma),
                ("centroid x", each.centroid[0], "mm", each.centroid_sigma),
                ("centroid y", each.centroid[1], "mm", each.centroid_sigma),
            )
        ]
        region = f"{each.region}, cut: lower bounds" if each.cut else each.region
        rows.append(("", [str(n), region, *numbers]))
    evidence = [f"Dent {n}: {each.evidence}." for n, each in enumerate(dents, 1)]
    return {"table": table("dent-table", heads, rows, texts=2), "evidence": evidence}


def differences_table(given: Measurement, figures: Figures) -> dict[str, Any] | None:
    """A row per map that is taken off."""
    rows = []
    for name, other in given.less.items():
        change, sigma = given.height.difference(other)
        both = given.height.good & other.good & np.isfinite(change)
        moved, spread = (part[both] if both.any() else np.array([np.nan]) for part in (change, sigma))
        beyond = float(np.mean(np.abs(moved) > 3 * spread)) if both.any() else np.nan
        readings = (
            ("mean", moved.mean(), "mm"),
            ("rms", rms(moved), "mm"),
            ("largest", moved.max(), "mm"),
            ("smallest", moved.min(), "mm"),
            ("sigma", np.median(spread), "mm"),
            ("beyond 3 sigma", beyond, "%"),
        )
        label = f"{given.name} − {name}"
        shown = [figures.show(f"{label}, {what}", value, unit) for what, value, unit in readings]
        rows.append(("", [label, *shown]))
    heads = ("difference", "mean", "rms", "largest", "smallest", "sigma, median", "pixels beyond 3 sigma")
    return table("difference-table", heads, rows) if rows else None


def budget_table(given: Measurement, figures: Figures) -> dict[str, Any]:
    """A row per source of uncertainty."""
    readings = given.readings
    names = dict.fromkeys(name for sources in readings.values() for name in sources)
    rows = [
        (
            "",
            [
                name,
                *(
                    figures.show(f"{reading}: {name}", each[name], "mm") if name in each else ""
                    for reading, each in readings.items()
                ),
            ],
        )
        for name in names
    ]
    return table("budget-table", ("standard deviation", *readings), rows)


def flags_table(rows: list[FlagRow], areas: bool, figures: Figures) -> dict[str, Any]:
    """Every pixel by its first reason, and the sum."""
    show = figures.show
    cells = []
    for row in rows:
        swatch = Markup('<span class="swatch" style="background:{}"></span> {}').format(row.colour, row.name)
        area = [show(f"flag {row.name}, area", row.area, "mm²")] if areas else []
        share = show(f"flag {row.name}, share", row.share, "%")
        cells.append(("", [swatch, row.meaning, f"{row.count:,}" if row.bit >= 0 else "", *area, share]))
    whole = [show("mirror, area", sum(row.area for row in rows), "mm²")] if areas else []
    total = show("all flags, share", sum(row.share for row in rows), "%")
    pixels = f"{sum(row.count for row in rows):,}"
    cells.append(("best", ["the mirror" if areas else "the image", "", pixels, *whole, total]))
    heads = ("first reason", "meaning", "pixels", *(("area",) if areas else ()), "share")
    return {"table": table("flag-counts", heads, cells, texts=2), "areas": areas}
