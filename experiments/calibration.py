"""Error against its error bar: histograms of error / sigma, and measured against predicted error."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter
from numpy.typing import NDArray

from .images import figure_uri, label_axes, new_figure

__all__ = ["Quantity", "histogram_figure", "reliability", "reliability_figure"]

Array = NDArray[np.floating[Any]]
BINS = 12
MOST = 400_000  # samples that enter a figure; the numbers on the page use them all


@dataclass(frozen=True, slots=True)
class Quantity:
    """Errors and their sigmas over unflagged pixels (1-D, same unit), with name and unit."""

    name: str
    unit: str
    error: Array
    sigma: Array

    @classmethod
    def of(cls, name: str, unit: str, error: Array, sigma: Array, where: NDArray[np.bool_]) -> "Quantity":
        """The pixels where `where` holds and sigma is a positive number."""
        use = where & np.isfinite(sigma) & (sigma > 0) & np.isfinite(error)
        return cls(name, unit, error[use], sigma[use])

    def sample(self) -> tuple[Array, Array]:
        """Error and sigma of at most MOST pixels, evenly taken."""
        step = max(1, -(-self.error.size // MOST))
        return self.error[::step], self.sigma[::step]


def reliability(error: Array, sigma: Array) -> tuple[Array, Array]:
    """Rms sigma and rms error in BINS bins of equally many pixels, sorted by sigma."""
    order = np.argsort(sigma, kind="stable")
    groups = [group for group in np.array_split(order, BINS) if group.size]
    predicted = np.array([np.sqrt(np.mean(sigma[group] ** 2)) for group in groups])
    measured = np.array([np.sqrt(np.mean(error[group] ** 2)) for group in groups])
    return predicted, measured


def histogram_figure(quantities: list[Quantity]) -> str:
    """Histograms of error / sigma beside the unit normal density."""
    figure = new_figure(10.0, 2.9)
    t = np.linspace(-5, 5, 201)
    for axes, quantity in zip(figure.subplots(1, len(quantities), squeeze=False)[0], quantities, strict=True):
        error, sigma = quantity.sample()
        if error.size:
            axes.hist(
                np.clip(error / sigma, -5, 5), bins=np.linspace(-5, 5, 81), density=True, color="#6c9bcf"
            )
        axes.plot(t, np.exp(-(t**2) / 2) / np.sqrt(2 * np.pi), color="#b3402e", lw=1.4, label="unit normal")
        label_axes(axes, "error / sigma", title=quantity.name)
        axes.set_xlim(-5, 5)
        axes.set_ylim(0, 0.55)
    figure.axes[0].set_ylabel("density", fontsize=9)
    figure.axes[0].legend(fontsize=8, frameon=False, loc="upper left")
    return figure_uri(figure)


def reliability_figure(quantities: list[Quantity]) -> str:
    """Measured rms error against predicted sigma, in bins of sigma; on the line the error bars are true."""
    figure = new_figure(10.0, 3.1)
    for axes, quantity in zip(figure.subplots(1, len(quantities), squeeze=False)[0], quantities, strict=True):
        error, sigma = quantity.sample()
        if error.size:
            predicted, measured = reliability(error, sigma)
            positive = measured[measured > 0]
            ends = min(predicted.min(), positive.min(initial=np.inf)), max(predicted.max(), measured.max())
            span = np.array([ends[0] / 1.5, ends[1] * 1.5])
            axes.fill_between(span, span / 1.25, span * 1.25, color="#1f7a4d", alpha=0.12, lw=0)
            axes.plot(span, span, color="#5a6675", lw=1)
            axes.loglog(predicted, measured, "o", ms=4.5, color="#2563a8")
            for axis, limits in ((axes.xaxis, axes.set_xlim), (axes.yaxis, axes.set_ylim)):
                limits(*span)
                subs = (1.0, 2.0, 5.0) if span[1] < 30 * span[0] else (1.0,)
                axis.set_major_locator(LogLocator(subs=subs))
                axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:.3g}"))
                axis.set_minor_formatter(NullFormatter())
        unit = f"[{quantity.unit}]"
        label_axes(axes, f"predicted sigma {unit}", f"rms error {unit}", quantity.name)
    return figure_uri(figure)
