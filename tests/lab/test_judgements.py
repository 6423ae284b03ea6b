"""`python -m lab judgements`: its counts, and its section of the page."""

from pathlib import Path

import pytest

from lab.judgements import decode, heights
from lab.judgements.captures import CODES, LIGHTS, draw
from lab.judgements.record import Row, false_alarms, misses, with_section
from optolever.decode import decode as run_decode

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
    of_another = "| part | old |\n| decode | torn | any | 3 | 1 |\n| decode | rough | 0.06 | 3 | 0 | |\n"
    page.write_text(f"# Benchmarks\n\n## Judgements\n\nold\n{of_another}\n## Further\n\nlast\n", "utf-8")
    for _ in range(2):
        with_section(page, ROWS, "python -m lab judgements")
        text = page.read_text("utf-8")
        assert "old" not in text
        assert text.count("| heights | camera moved | moved, motion | 3 | 1 |") == 1
        assert text.count("| decode |") == 2
        assert text.startswith("# Benchmarks\n\n## Judgements\n")
        assert text.endswith("\n## Further\n\nlast\n")


SMALL = ("untouched", "ball", "camera pose", "press and rest exchanged", "u reversed")
#: Kinds that tests/reconstruct/test_rig.py has.
APART = ("both poses", "glass", "motion, sag")
OTHERS = tuple({*heights.RIGHT, *heights.TYPED, *heights.WRONG} - {*SMALL, *APART})


@pytest.mark.parametrize("kinds", [SMALL, pytest.param(OTHERS, marks=pytest.mark.slow, id="others")])
def test_right_maps_are_named_by_no_test_and_wrong_ones_are(kinds: tuple[str, ...]) -> None:
    found = heights.rows(2, kinds)
    assert sum(row.right for row in found) > 25
    assert [row for row in found if row.false_alarms] == []
    wrong = [row for row in found if row.wrong]
    assert len(wrong) >= 2
    assert [row for row in wrong if row.missed] == []


FEW = ("gray+phase", "phase:steps=3", "gray:inverses=false")
MORE = tuple(code for code in CODES if code not in FEW)


@pytest.mark.parametrize("codes", [FEW, pytest.param(MORE, marks=pytest.mark.slow)])
def test_right_captures_are_refused_by_no_test_and_wrong_ones_are(codes: tuple[str, ...]) -> None:
    """One of twenty wrong captures at most stays without a word."""
    found = decode.rows(1, codes)
    assert len({row.kind for row in found if row.right}) >= len(LIGHTS)
    assert [row for row in found if row.false_alarms] == []
    wrong = sum(row.wrong for row in found)
    assert wrong > 15 * len(codes)
    assert sum(row.missed for row in found) <= 0.05 * wrong


@pytest.mark.parametrize(
    ("code", "light"),
    [("phase:steps=3", "lag 20 %"), ("phase", "gamma 2.2"), ("gray+phase:axes=u", "soft focus")],
)
def test_cards_at_several_depths_are_refused_by_no_test(code: str, light: str) -> None:
    drawn = draw(code, LIGHTS[light], 11)
    tests = run_decode(drawn.frames, drawn.sequence).tests
    assert len(tests) >= 3
    assert [one.test for one in tests if one.fails] == []
