"""The calibration's page: where the camera is drawn, and what is red."""

import base64
import json
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from optolever.notices import Notice
from optolever.report import write_rig_report
from optolever.scene import Covariance, load, resize

Browser = Callable[..., str]


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
    write_rig_report(rig, found, judged, path)
    return path.read_text()


def test_its_maps_hold_the_residuals_and_are_drawn(page: str, tmp_path: Path, browser: Browser) -> None:
    found = re.search(r'id="map-data">(.*?)</script>', page, re.DOTALL)
    assert found is not None
    layers = json.loads(found[1])["capture-2"]["layers"]
    assert [each["name"] for each in layers] == ["u", "v"]
    drawn = np.frombuffer(base64.b64decode(layers[0]["data"]), "<f4")
    assert set(drawn[np.isfinite(drawn)].tolist()) == {-1.5, 1.5}
    (tmp_path / "rig.html").write_text(page)
    dom = browser(tmp_path / "rig.html", "--dump-dom")
    assert 'data-charts="ready"' in dom
    heights = json.loads(found[1])["heights"]["layers"]
    assert dom.count("<canvas") == 2 * 2 + len(heights)


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
