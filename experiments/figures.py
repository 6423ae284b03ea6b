"""Numbers of a page as text, and the same numbers in a file: one list for both."""

import csv
import math
from dataclasses import dataclass, field
from pathlib import Path

from markupsafe import Markup

from optolever.files import atomic_file

from .images import length_unit

__all__ = ["Figures", "quantity"]


@dataclass(frozen=True, slots=True)
class Figures:
    """Numbers by name: value, standard deviation (NaN: none) and unit, in the order in which a page shows
    them."""

    rows: dict[str, tuple[float, float, str]] = field(default_factory=dict)

    def show(self, name: str, value: float, unit: str = "", sigma: float = math.nan) -> Markup:
        """The number as an element of the page; the file gets it by this name."""
        self.rows[name] = float(value), float(sigma), unit
        return Markup('<span class="figure" data-figure="{}">{}</span>').format(
            name, quantity(value, unit, sigma)
        )

    def save(self, path: str | Path) -> None:
        """Write a CSV: name, value, sigma, unit; sigma empty where there is none."""
        with atomic_file(path) as temporary, temporary.open("w", newline="", encoding="utf-8") as stream:
            rows = csv.writer(stream)
            rows.writerow(("name", "value", "sigma", "unit"))
            for name, (value, sigma, unit) in self.rows.items():
                rows.writerow((name, repr(value), "" if math.isnan(sigma) else repr(sigma), unit))


def quantity(value: float, unit: str = "", sigma: float = math.nan) -> str:
    """A number for reading: as many digits as its sigma leaves two of, four without one; lengths (mm) in the
    unit in which they read well, shares (unit %) in per cent.

    >>> quantity(4000.5961, "mm", 0.0023)
    '4000.5961 ± 0.0023 mm'
    >>> quantity(4.6e-4, "mm"), quantity(0.98765, "%"), quantity(0.0123, "mm", 2.5e-6)
    ('460.0 nm', '98.77 %', '12.3000 ± 0.0025 µm')
    """
    if not math.isfinite(value):
        return "–"
    factor = 1.0
    if unit == "%":
        factor = 100.0
    elif unit == "mm":
        factor, unit = length_unit(value if value else sigma)
    value, sigma = factor * value, factor * sigma
    if not (math.isfinite(sigma) and sigma > 0):
        text = _plain(value)
    else:
        digits = 1 - math.floor(math.log10(float(f"{sigma:.1e}")))
        places = max(digits, 0)
        rounded = round(value, digits) + 0.0  # no minus zero
        if digits > 9 or digits < -4:
            text = f"{_plain(value)} ± {_plain(float(f'{sigma:.1e}'))}"
        else:
            text = f"{rounded:.{places}f} ± {float(f'{sigma:.1e}'):.{places}f}"
    return f"{text} {unit}".rstrip().replace("-", "−")


def _plain(value: float) -> str:
    """Four significant digits, all of an integer part."""
    if value == 0:
        return "0"
    if 1e-3 <= abs(value) < 1e7:
        return f"{value:.0f}" if abs(value) >= 999.5 else f"{value:#.4g}"
    digits, _, power = f"{value:.3e}".partition("e")
    return f"{digits} × 10" + str(int(power)).translate(str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"))
