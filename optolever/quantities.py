"""Numbers with units as text, of pages and of the program."""

import math

__all__ = ["length", "length_unit", "number", "quantity", "two_digits"]


def length_unit(size: float) -> tuple[float, str]:
    """Factor and name of the unit in which a length given in mm reads well."""
    if abs(size) >= 0.1 or size == 0 or not math.isfinite(size):
        return 1.0, "mm"
    return (1e3, "µm") if abs(size) >= 1e-4 else (1e6, "nm")


def quantity(value: float, unit: str = "", sigma: float = math.nan, size: float = 0.0) -> str:
    """A number for reading: as many digits as its sigma leaves two of, four without one; lengths (mm) in the
    unit in which they read well (or `size`, of a number beside it), shares (unit %) in per cent.

    >>> quantity(4000.5961, "mm", 0.0023)
    '4000.5961 ± 0.0023 mm'
    >>> quantity(4.6e-4, "mm"), quantity(0.98765, "%"), quantity(0.0123, "mm", 2.5e-6)
    ('0.4600 µm', '98.77 %', '12.3000 ± 0.0025 µm')
    >>> quantity(9.98e-5, "mm", 1.2e-6, size=1.01e-4)
    '0.0998 ± 0.0012 µm'
    """
    if not math.isfinite(value):
        return "–"
    factor = 1.0
    if unit == "%":
        factor = 100.0
    elif unit == "mm":
        factor, unit = length_unit(size or value or sigma)
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


def number(value: float, unit: str = "") -> str:
    """Four significant digits without trailing zeros, and a unit; a dash if not finite.

    >>> number(0.25, "s"), number(69840.0), number(6.984e-6)
    ('0.25 s', '69840', '6.984 × 10⁻⁶')
    """
    if not math.isfinite(value):
        return "-"
    text = f"{value:.4g}"
    return f"{_plain(value) if 'e' in text else text} {unit}".rstrip().replace("-", "−")


def length(mm: float) -> str:
    """A length with two significant digits in nm, µm or mm.

    >>> length(0.0000069), length(0.0034), length(0.44), length(7.6e-4)
    ('6.9 nm', '3.4 µm', '0.44 mm', '760 nm')
    """
    if not math.isfinite(mm):
        return "unknown"
    factor, unit = (1.0, "mm") if abs(mm) >= 0.0995 else (1e3, "µm") if abs(mm) >= 0.995e-3 else (1e6, "nm")
    return f"{two_digits(factor * mm)} {unit}"


def two_digits(value: float) -> str:
    """Two significant digits; a power of ten below 1e-4 and from 1e7.

    >>> two_digits(760.4), two_digits(0.0123), two_digits(6.3e-5)
    ('760', '0.012', '6.3 × 10⁻⁵')
    """
    value = float(f"{value:.1e}")
    if value and not 1e-4 <= abs(value) < 1e7:
        return _power(value, 1).replace("-", "−")
    return (f"{value:.0f}" if abs(value) >= 10 else f"{value:.2g}").replace("-", "−")


def _plain(value: float) -> str:
    """Four significant digits, all of an integer part."""
    if value == 0:
        return "0"
    if 1e-3 <= abs(value) < 1e7:
        return f"{value:.0f}" if abs(value) >= 999.5 else f"{value:#.4g}"
    return _power(value, 3)


def _power(value: float, places: int) -> str:
    """Digits and a power of ten."""
    digits, _, power = f"{value:.{places}e}".partition("e")
    return f"{digits} × 10" + str(int(power)).translate(str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"))
