"""The calibration's page: where the camera is drawn, and what is red."""

import re
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import matplotlib
import numpy as np
import pytest

from optolever.notices import Notice
from optolever.report import write_rig_report
from optolever.scene import Covariance, load, resize


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> str:
    return written(tmp_path_factory.mktemp("rig") / "rig.html")


def written(path: Path) -> str:
    """Two captures, one with a chi of 1.5; four numbers: sharp, known from the prior, 4.9 and 5.1 off."""
    rig = resize(load("prism48"), 60, 80)
    names = ("camera.ry", "pattern.z")
    scene = replace(rig, covariance=Covariance(names, np.diag([1e-4, 1e-2]) ** 2))
    numbers = [
        {"name": name, "value": value, "sigma": sigma, "prior": 1.0, "prior_sigma": 0.1}
        for name, value, sigma in (("a", 1.1, 0.01), ("b", 1.1, 0.09), ("c", 1.49, 0.01), ("d", 0.49, 0.09))
    ]
    sign = np.where(np.arange(50) % 2, 1.0, -1.0)
    row, col = np.arange(50.0), np.arange(50.0)
    residuals = {name: (row, col, chi * sign, chi * sign) for name, chi in (("rest", 1.0), ("ball", 1.5))}
    judged = {"rest": {"chi": 1.0}, "ball": {"chi": 1.5}}
    notices = [Notice("wrong", 2.0, 1.0, "mend it"), Notice("remark", np.nan, np.nan, "")]
    found: Any = SimpleNamespace(
        scene=scene,
        adjustment=SimpleNamespace(chi=1.5),
        parameters=numbers,
        residuals=residuals,
        notices=notices,
    )
    write_rig_report(rig, found, judged, {"adjust": 1.0}, path)
    return path.read_text()


def test_its_figures_are_drawn_in_no_user_s_style(page: str, tmp_path: Path) -> None:
    with matplotlib.rc_context({"text.usetex": True, "font.size": 30}):
        again = written(tmp_path / "rig.html")
    figures = re.compile('data:image/png;base64,[^"]*')
    assert figures.findall(again) == figures.findall(page) != []


def test_what_is_beyond_its_limit_is_red(page: str) -> None:
    rows = {name: kind for kind, name in re.findall(r'<tr(?: class="(\w+)")?><td>(\w+)</td>', page)}
    assert {name: rows[name] for name in "abcd"} == {"a": "", "b": "soft", "c": "", "d": "beyond"}
    assert rows["rest"] == ""
    assert rows["ball"] == "beyond"
    assert '<div class="value beyond">1.500</div>' in page
    assert '<span class="beyond">ball: chi 1.500</span>' in page
    assert "<span>rest: chi 1.000</span>" in page
    assert re.search(r'<li class="beyond">wrong', page)
    assert re.search(r"<li>remark", page)
    assert re.search(r"\.beyond[^{}]*\{ color: var\(--bad\)", page)
