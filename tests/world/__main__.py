"""`python -m tests.world [NAME ...] [--rigs 4] [--code CODE ...]`: clean captures and effects in a table."""

import argparse
import warnings
from collections import Counter

import numpy as np

from .judge import LIMITS, Verdict, cases, run
from .light import World

HEAD = f"{'effect':22s} {'code':30s}  n  good least | places  worst ratio | heights  worst ratio >1%"


def line(name: str, code: str, found: list[Verdict]) -> str:
    """Figures over the captures of one effect and one code."""

    def of(field: str, statistic: str = "nanmean") -> float:
        return float(getattr(np, statistic)([getattr(one, field) for one in found]))

    told = Counter(text for one in found for text in one.told)
    figures = (
        f"{len(found):2d}  {of('good'):.3f} {of('good', 'min'):.3f}"
        f" | {of('places'):.1e} {of('places', 'nanmax'):.1e} {of('place_ratio', 'nanmedian'):.2f}"
        f" | {of('heights'):.1e} {of('heights', 'nanmax'):.1e} {of('height_ratio', 'nanmedian'):.2f}"
        f" {sum(one.silent > LIMITS['faults']['silent'] for one in found):2d}"
    )
    worst = max(found, key=lambda one: np.nan_to_num(one.heights)).rig
    words = "; ".join(f"{count} x {text[:60]}" for text, count in told.most_common(2))
    return f"{name:22s} {code:30s} {figures}  worst {worst}; {words}"


def main() -> None:
    """Print the table."""
    given = argparse.ArgumentParser("python -m tests.world", description=__doc__)
    given.add_argument("names", nargs="*", help="effects, or 'clean' (default: all)")
    given.add_argument("--rigs", type=int, default=4)
    given.add_argument("--first", type=int, default=0, help="number of the first rig")
    given.add_argument("--code", nargs="*", help="codes (default: those of limits.toml)")
    asked = given.parse_args()
    warnings.simplefilter("ignore")
    print(HEAD)
    for name, codes, world in cases():
        if asked.names and name not in asked.names:
            continue
        for code in asked.code or codes:
            rigs = range(asked.first, asked.first + asked.rigs)
            print(line(name, code, [run(rig, code, World(**world)) for rig in rigs]), flush=True)


main()
