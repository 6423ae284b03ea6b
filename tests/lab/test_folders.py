"""Folders of foreign pictures: what `python -m lab folders` says of them is what was done to them."""

import json
from dataclasses import replace
from pathlib import Path

import pytest

from lab.folders import FAULTS, Folder, drawn_folder, judged
from lab.program import run


@pytest.fixture(scope="module")
def reversed_order() -> Folder:
    return drawn_folder(0, "order reversed")


def test_a_cause_is_right_for_its_own_fault_alone(reversed_order: Folder, tmp_path: Path) -> None:
    """The same pictures are named falsely, or a false alarm, where something else was done to them."""
    verdicts = {}
    for i, fault in enumerate(("order reversed", "bits reversed", "")):
        place = tmp_path / str(i)
        place.mkdir()
        verdicts[fault] = judged(replace(reversed_order, fault=fault), place).verdict
    assert list(verdicts.values()) == ["named rightly", "named falsely", "false alarm"]


def test_places_off_the_truth_are_silently_wrong(tmp_path: Path) -> None:
    """A folder without a fault is decoded within 5 sigma; beside another truth it is not."""
    folder = drawn_folder(10)
    area = folder.area
    moved = replace(area, u=area.u + 2.0, centre=replace(area.centre, u=area.centre.u + 2.0))
    found = []
    for i, truth in enumerate((area, moved)):
        place = tmp_path / str(i)
        place.mkdir()
        found.append(judged(replace(folder, area=truth), place))
    assert [one.verdict for one in found] == ["within 5 sigma", "silently wrong"]
    assert found[1].silent == pytest.approx(found[1].good, abs=0.01)


def test_the_table_counts_verdicts(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    numbers = tmp_path / "folders.json"
    assert run(["folders", "--faulty", "2", "--plain", "1", "--every", "--json", str(numbers)]) == 0
    rows = json.loads(numbers.read_text())["folders"]
    assert [row["fault"] for row in rows] == [*FAULTS[:2], ""]
    assert [row["verdict"] for row in rows] == ["named rightly"] * 2 + ["within 5 sigma"]
    printed = capsys.readouterr().out
    assert "2, 100% of them rightly" in printed
