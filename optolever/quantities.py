"""Numbers with units as text, of pages and of the program."""

import math

__all__ = ["length_unit", "quantity"]


def length_unit(size: float) -> tuple[float, str]:
    """Factor and name of the unit in which a length given in mm reads well."""
    if abs(size) >= 0.1 or size == 0 or not math.isfinite(size):
        return 1.0, "mm"
    return (1e3, "µm") if abs(size) >= 1e-4 else (1e6, "nm")


def quantity(value: float, unit: str = "", sigma: float = math.nan) -> str:
    """A number for reading: as many digits as its sigma leaves two of, four without one; lengths (mm) in the
    unit in which they read well, shares (unit %) in per cent.

    >>> quantity(4000.5961, "mm", 0.0023)
    '4000.5961 ± 0.0023 mm'
    >>> quantity(4.6e-4, "mm"), quantity(0.98765, "%"), quantity(0.0123, "mm", 2.5e-6)
    ('0.4600 µm', '98.77 %', '12.3000 ± 0.0025 µm')
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
