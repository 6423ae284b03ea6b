"""Numbers of a page as text, and the same numbers in a file: one list for both."""

import csv
import math
from dataclasses import dataclass, field
from pathlib import Path

from markupsafe import Markup

from optolever.files import atomic_file
from optolever.quantities import quantity

__all__ = ["Figures"]


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
