"""Verbs that are given a record of another type name it in one line, and what makes one."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from optolever import InputError
from optolever.calibration import calibrate
from optolever.decode import Correspondence, decode
from optolever.patterns import Frame, sequence
from optolever.projector import capture
from optolever.reconstruct import reconstruct
from optolever.scene import dent, load
from optolever.schema import checked

SCENE, CODE, FRAMES = load("prism48"), sequence("gray", 4, 4), np.zeros((3, 4, 4), np.uint8)
FLAT, SEEN = dent("flat", SCENE), object.__new__(Correspondence)
#: Values of no record: what users pass by mistake; records mistaken for others.
WRONG = [None, "gray+phase", 7, np.zeros((3, 4)), object(), ["gray"], Frame("white"), CODE, SCENE]
#: Verb, its arguments, the names of records among them.
VERBS: list[tuple[Callable[..., Any], dict[str, Any], tuple[str, ...]]] = [
    (load, {"preset_or_path": "prism48"}, ("preset_or_path",)),
    (sequence, {"name": "gray", "rows": 4, "cols": 4}, ("name",)),
    (capture, {"scene": SCENE, "surface": FLAT, "sequence": CODE}, ("scene", "surface", "sequence")),
    (decode, {"frames": FRAMES, "sequence": CODE}, ("sequence",)),
    (reconstruct, {"correspondence": SEEN, "scene": SCENE, "rest": None}, ("correspondence", "rest")),
    (calibrate, {"scene": SCENE, "observations": []}, ("scene", "observations")),
]


@pytest.mark.parametrize(
    ("verb", "given", "name"),
    [
        pytest.param(verb, given, name, id=f"{verb.__name__}({name})")
        for verb, given, names in VERBS
        for name in names
    ],
)
def test_a_wrong_record_is_one_line(verb: Callable[..., Any], given: dict[str, Any], name: str) -> None:
    for value in WRONG:
        if isinstance(value, type(given[name])) and value != ["gray"]:
            continue
        with pytest.raises(InputError) as caught:
            verb(**{**given, name: value})
        line = str(caught.value)
        assert line.startswith((f"{name}: ", f"{name}[0]: ")), line
        assert "must be a" in line
        assert "\n" not in line


def test_a_masked_array_is_not_taken_for_a_plain_one() -> None:
    masked = np.ma.masked_equal(FRAMES, 0)
    with pytest.raises(InputError, match=r"frames: a masked array.*filled"):
        decode(masked, CODE)


def test_underflow_is_harmless() -> None:
    """Whatever np.seterr says."""
    square = checked()(np.square)
    with np.errstate(under="raise"):
        assert square(1e-300) == 0.0
