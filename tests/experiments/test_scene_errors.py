"""Scenes that are a little wrong: told from right ones, and mended by a rest capture."""

from optolever.experiments.scene_errors import ERRORS, scene_errors


def test_wrong_scenes_are_told_from_right_ones() -> None:
    found = list(scene_errors(2))
    assert [one.wrong for one in found] == [*ERRORS, *ERRORS]
    for one in found:
        assert one.noticed == (one.wrong != "right")
        if one.noticed:
            assert one.mended < 0.1 * one.error
