"""`optolever camera preview`: lines on the terminal, and the page's answers."""

import contextlib
import http.client
import json
import re
from pathlib import Path

import cv2
import numpy as np
import pytest

from optolever.cli import run
from optolever.cli.preview import Page, View, glance, still
from optolever.projector import aim
from optolever.scene import load, resize


@pytest.fixture
def rig(tmp_path: Path) -> Path:
    file = tmp_path / "rig.toml"
    resize(load("prism48"), 48, 64).save(file)
    file.write_text(file.read_text() + '\n[devices]\ncamera = "virtual"\n')
    return file


def test_lines_and_figures_of_a_virtual_rig(
    rig: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "p.json"
    assert (
        run(["camera", "preview", "--rig", str(rig), "--text", "--seconds", "0.3", "--json", str(out)]) == 0
    )
    assert re.search(
        r"sees the display 1?\d\d %; saturated 0 %; sharpness \d+ % of its best", capsys.readouterr().out
    )
    found = json.loads(out.read_text())
    assert found["sees_share"] > 0.9
    assert found["good"]


def _ask(page: Page, path: str, **headers: str) -> tuple[int, bytes]:
    connection = http.client.HTTPConnection(page.address.removeprefix("http://").rstrip("/"), timeout=10)
    connection.request("GET", path, headers=headers)
    with contextlib.closing(connection), connection.getresponse() as answer:
        return answer.status, answer.read()


def test_the_page_outlines_the_reflection_and_marks_saturated_pixels() -> None:
    white = np.full((120, 160), 20, np.uint8)
    white[:, :80] = 200
    white[50:70, 20:40] = 255
    black = np.full_like(white, 20)
    with Page(0) as page:
        assert json.loads(_ask(page, "/next?after=0")[1]) == {"count": 0}
        page.show(View(white, 8, aim(white, white, black, 8), 1.0))
        now = json.loads(_ask(page, "/next?after=0")[1])
        assert (now["count"], now["good"]) == (1, False)
        assert now["sees_share"] == pytest.approx(0.5, abs=0.02)
        jpeg = np.frombuffer(_ask(page, "/picture?1")[1], np.uint8)
        blue, green, red = cv2.imdecode(jpeg, cv2.IMREAD_COLOR).astype(float).transpose(2, 0, 1)
        assert (red - blue)[55:65, 25:35].min() > 100
        assert (green - red)[30:90, 78:82].max() > 60
        for path, kind in (
            ("/", b"<!doctype html>"),
            ("/preview.js", b"use strict"),
            ("/preview.css", b"color"),
        ):
            status, text = _ask(page, path)
            assert (status, kind in text) == (200, True)
        assert _ask(page, "/", Host="elsewhere.example:80")[0] == 403
        assert _ask(page, "/next?after=" + 5000 * "9")[0] == 200


def test_a_glance_at_one_monitor_is_its_last_view(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("optolever.cli.preview._GLANCE_S", 0.2)
    level = np.full((20, 20), 100, np.uint8)
    one = View(level, 8, aim(level, level, level, 8), 1.0)
    assert glance(still(one)) is one
