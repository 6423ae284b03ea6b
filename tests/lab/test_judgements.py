"""`python -m lab judgements`: its counts, and its section of the page."""

from pathlib import Path

import pytest

from lab.judgements import decode, heights
from lab.judgements.captures import CODES, LIGHTS
from lab.judgements.record import Row, false_alarms, misses, with_section

ROWS = [
    Row("heights", "moved", "ball", 0.1, 5, 0, 0, 0),
    Row("heights", "moved", "punch", 0.1, 4, 2, 0, 0),
    Row("heights", "moved, motion", "camera moved", 0.1, 0, 0, 3, 1),
]


def test_counts_by_test_and_by_kind_of_fault() -> None:
    assert false_alarms(ROWS) == [("heights", "moved", "0.1", "9", "2", "punch")]
    assert misses(ROWS) == [("heights", "camera moved", "moved, motion", "3", "1")]


def test_the_section_replaces_itself_and_nothing_else(tmp_path: Path) -> None:
    page = tmp_path / "benchmarks.md"
    page.write_text("# Benchmarks\n\n## Judgements\n\nold\n\n## Further\n\nlast\n", "utf-8")
    for _ in range(2):
        with_section(page, ROWS, "python -m lab judgements")
        text = page.read_text("utf-8")
        assert "old" not in text
        assert text.count("| heights | camera moved | moved, motion | 3 | 1 |") == 1
        assert text.startswith("# Benchmarks\n\n## Judgements\n")
        assert text.endswith("\n## Further\n\nlast\n")


SMALL = ("untouched", "ball", "camera pose", "press and rest exchanged", "u reversed")


@pytest.mark.parametrize("kinds", [SMALL, pytest.param(None, marks=pytest.mark.slow)])
def test_right_maps_are_named_by_no_test_and_wrong_ones_are(kinds: tuple[str, ...] | None) -> None:
    found = heights.rows(2, kinds)
    assert sum(row.right for row in found) > 25
    assert [row for row in found if row.false_alarms] == []
    wrong = [row for row in found if row.wrong]
    assert len(wrong) >= 2
    assert [row for row in wrong if row.missed] == []


FEW = ("gray+phase",), ("lag 20 %", "flicker 5 %", "half in the dark")


@pytest.mark.parametrize(
    ("codes", "lights"), [FEW, pytest.param(CODES, tuple(LIGHTS), marks=pytest.mark.slow)]
)
def test_right_captures_are_refused_by_no_test_and_wrong_ones_are(
    codes: tuple[str, ...], lights: tuple[str, ...]
) -> None:
    """Of codes with bits and fringes; of all, one of four at most stays without a word."""
    found = decode.rows(1, codes, lights)
    assert len({row.kind for row in found if row.right}) >= len(lights)
    assert [row for row in found if row.false_alarms] == []
    wrong = [row for row in found if row.wrong]
    assert len(wrong) > 15
    assert sum(row.missed for row in wrong) <= (
        0 if codes == FEW[0] else 0.25 * sum(row.wrong for row in wrong)
    )
