"""Numbers with units as text, of pages and of the program."""

import math
from collections.abc import Sequence

__all__ = ["by_parts", "length", "length_unit", "noise_and_rig", "number", "quantity", "two_digits"]


def length_unit(size: float) -> tuple[float, str]:
    """Factor and name of the unit in which a length given in mm reads well."""
    if abs(size) >= 0.1 or size == 0 or not math.isfinite(size):
        return 1.0, "mm"
    return (1e3, "µm") if abs(size) >= 1e-4 else (1e6, "nm")


def quantity(value: float, unit: str = "", sigma: float = math.nan, size: float = 0.0) -> str:
    """A number for reading: as many digits as its sigma leaves two of, but three of its own above a
    thousandth of that; four without a sigma. Lengths (mm) come in the unit in which they read well (or
    `size`, of a number beside it), shares (unit %) in per cent.

    >>> quantity(4000.5961, "mm", 0.0023)
    '4000.5961 ± 0.0023 mm'
    >>> quantity(4.6e-4, "mm"), quantity(0.98765, "%"), quantity(0.0123, "mm", 2.5e-6)
    ('0.4600 µm', '98.77 %', '12.3000 ± 0.0025 µm')
    >>> quantity(9.98e-5, "mm", 1.2e-6, size=1.01e-4)
    '0.0998 ± 0.0012 µm'
    >>> quantity(3.04e-4, "mm", 0.022)
    '0.304 ± 22 µm'
    """
    if not math.isfinite(value):
        return "–"
    number, spread, unit = _rounded(value, unit, sigma, size)
    return f"{number}{spread and f' ± {spread}'} {unit}".rstrip()


def by_parts(known: Sequence[float], unit: str = "", what: str = "") -> str:
    """A value, its standard deviations by noise (NaN: unknown) and by the rig: rounded by the noise, both
    apart; what: the value is.

    >>> by_parts((6.5e-4, 2e-5, 0.037), "mm", "rms")
    '0.650 µm rms ± 20 nm noise, ± 37 µm rig'
    """
    value, noise, rig = known
    if not math.isfinite(value):
        return "–"
    text, _, name = _rounded(value, unit, noise if noise > 0 else rig, 0.0)
    return " ".join(part for part in (text, name, what, noise_and_rig(noise, rig, unit)) if part)


def noise_and_rig(noise: float, rig: float, unit: str = "mm") -> str:
    """Standard deviations by noise (NaN: unknown) and by the errors of the rig; 0: an exact scene."""

    def text(sigma: float) -> str:
        return length(sigma) if unit == "mm" or math.isnan(sigma) else f"{two_digits(sigma)} {unit}".rstrip()

    return f"± {text(noise)} noise" + (f", ± {text(rig)} rig" if rig > 0 else "")


def _rounded(value: float, unit: str, sigma: float, size: float) -> tuple[str, str, str]:
    """The number, its standard deviation (empty: unknown) and the unit as text."""
    factor = 1.0
    if unit == "%":
        factor = 100.0
    elif unit == "mm":
        factor, unit = length_unit(size or value or sigma)
    value, sigma = factor * value, factor * sigma
    if not (math.isfinite(sigma) and sigma > 0):
        return _plain(value).replace("-", "−"), "", unit
    sigma = float(f"{sigma:.1e}")
    places = 1 - math.floor(math.log10(sigma))
    if not -4 <= places <= 9:
        return _plain(value).replace("-", "−"), _plain(sigma), unit
    own = 2 - math.floor(math.log10(abs(value))) if value else places
    digits = max(places, min(own, places + 3))
    rounded = round(value, digits) + 0.0  # no minus zero
    return f"{rounded:.{max(digits, 0)}f}".replace("-", "−"), f"{sigma:.{max(places, 0)}f}", unit


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
    if not math.isfinite(value):
        return "-"
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
