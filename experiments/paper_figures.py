"""Figures of the paper report: the seed's figures 5 to 14 and 20 redrawn, all methods beside each other."""

import numpy as np
from numpy.typing import NDArray

from .images import figure_uri, label_axes, new_figure
from .maps import length_unit
from .paper_rows import curve_name

__all__ = ["comparison_figure", "series_figure", "shape_figure"]

Array = NDArray[np.float64]
Curve = dict[str, Array]
STYLES = {"rises": ("#2563a8", "_"), "drops": ("#b3402e", "^"), "mean": ("#1f7a4d", "o")}  # the seed's signs
METHODS = (
    ("paper, lattice, mean", ("lattice", 1, True), "mean", "#b3402e"),
    ("paper, lattice, drops", ("lattice", 1, True), "drops", "#e0a030"),
    ("paper, every pixel, mean", ("pixels", 1, True), "mean", "#8a5fb0"),
    ("paper, every pixel, drops", ("pixels", 1, True), "drops", "#3b7dc4"),
    ("dense solver", ("dense", None, None), "mean", "#1f7a4d"),
)
FLOOR = 1e-13  # of the peak: what is drawn of smaller errors


def shape_figure(curve: Curve) -> str:
    """The mirror's cut, true depth over place (the seed's figures 5 and 10)."""
    figure = new_figure(10.0, 2.0)
    axes = figure.subplots()
    axes.plot(curve["l"], curve["d"], color="#1b2430", lw=1.6)
    axes.invert_yaxis()
    label_axes(axes, "l [mm]", "d [mm]", "the dent, into the prism downwards")
    return figure_uri(figure)


def series_figure(curve: Curve, fine: Curve) -> str:
    """Theta, depth and their errors by rises, drops and mean, as the seed draws them (6 to 9, 11 to 14).

    `fine` holds the true curve.
    """
    figure = new_figure(10.0, 6.0)
    grid = figure.subplots(2, 2)
    error = curve["mean d"] - curve["d"]
    factor, unit = length_unit(float(np.nanmax(np.abs(error), initial=0.0)) / 2)
    panels = (
        (grid[0, 0], "theta", 1e3, "theta [mrad]", False),
        (grid[0, 1], "d", 1.0, "d [mm]", False),
        (grid[1, 0], "theta", 1e3, "error of theta [mrad]", True),
        (grid[1, 1], "d", factor, f"error of d [{unit}]", True),
    )
    for axes, name, scale, label, against in panels:
        truth = curve[name]
        if not against:
            axes.plot(fine["l"], fine[name] * scale, color="#1b2430", lw=1.2, label="true")
        for series, (colour, marker) in STYLES.items():
            values = (curve[f"{series} {name}"] - (truth if against else 0)) * scale
            axes.plot(
                curve["l"], values, marker, color=colour, ms=4.5, mfc="none", mew=1, ls="none", label=series
            )
        if against:
            axes.axhline(0, color="#5a6675", lw=0.6)
        label_axes(axes, "l [mm]", label, "")
    grid[0, 1].legend(fontsize=8, frameon=False)
    return figure_uri(figure)


def comparison_figure(curves: dict[str, Curve], peak: float) -> str:
    """Absolute depth error over the peak, of every method, from exact data and from rendered frames."""
    figure = new_figure(10.0, 3.8)
    titles = {"exact": "from exact correspondences", "frames": "from rendered, noisy 8-bit frames"}
    seen = [data for data in titles if any(name.startswith(data) for name in curves)]
    for axes, data in zip(figure.subplots(1, len(seen), sharey=True, squeeze=False)[0], seen, strict=True):
        for label, (method, sign, gamma), series, colour in METHODS:
            curve = curves.get(curve_name(data, "reflection", method, sign, gamma))
            if curve is None:
                continue
            error = np.maximum(np.abs(curve[f"{series} d"] - curve["d"]) / peak, FLOOR)
            marker = "o" if method == "lattice" else ""
            axes.semilogy(curve["l"], error, color=colour, lw=1, marker=marker, ms=2.5, label=label)
        axes.axhline(0.01, color="#5a6675", lw=0.8, ls=":")
        label_axes(axes, "l [mm]", "|error of d| / peak" if data == "exact" else "", titles[data])
    handles, labels = figure.axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, fontsize=8, frameon=False, loc="outside upper center", ncols=5)
    return figure_uri(figure)
