"""The pages: everything that must be on them, nothing from the network, scripts that run, a surface that
turns.
"""

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from optolever.experiments import DemoResult, write_demo_report
from optolever.notices import Notice

Browser = Callable[..., str]
DEMO_IDS = [
    *("height_rms_rel", "unflagged_share", "sigma_ratio_height", "provenance"),
    *("height", "height-map", "profile-x", "profile-y", "profile-line"),
    *("dents", "slopes", "slope-x", "slope-y", "curvature"),
    *("sigma", "sigma-map", "error-map", "histogram-height", "reliability-u", "budget-table"),
    *("flags", "flag-counts", "flags-map", "correspondence", "u-map", "v-bent", "frames", "rig", "data"),
    *("timing", "reproduce", "surface-data", "map-data", "chart-data"),
]
FRAMES = (
    "<script>window.requestAnimationFrame = (draw) => setTimeout(draw, 1);</script>"  # --dump-dom has none
)
TURN = """
<script>
const canvas = document.querySelector(".viewer canvas"), before = canvas.toDataURL();
const at = (name, x, y) => canvas.dispatchEvent(
  new PointerEvent(name, { pointerId: 1, clientX: x, clientY: y, bubbles: true }));
canvas.setPointerCapture = () => {};
at("pointerdown", 100, 100); at("pointermove", 160, 90); at("pointerup", 160, 90);
setTimeout(() => {
  const turned = canvas.toDataURL(), select = document.querySelector(".viewer select");
  select.selectedIndex = 1; select.dispatchEvent(new Event("change"));
  setTimeout(() => {
    document.documentElement.dataset.turned = turned !== before;
    document.documentElement.dataset.recoloured = canvas.toDataURL() !== turned;
  }, 500);
}, 500);
</script>
"""


#: On the page, as are words of the command that no page may run.
NOTICE = Notice("slopes <contradict> each other", 9.0, 1.5, "calibrate")
BAD_WORDS = "</title><script>alert(1)</script>"


@pytest.fixture(scope="module")
def demo_page(demo: DemoResult, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("report") / "report.html"
    height, settings = replace(demo.height, notices=(NOTICE,)), demo.settings | {"sequence": BAD_WORDS}
    told = replace(demo, height=height, settings=settings)
    assert write_demo_report(told, path).seconds["report"] > 0
    return path


def without_data(html: str) -> str:
    """The page without its embedded pictures and data."""
    return re.sub(r"(data:[a-z/]+;base64,)?[A-Za-z0-9+/=]{200,}", "", html)


def test_page_asks_the_network_for_nothing(demo_page: Path) -> None:
    html = without_data(demo_page.read_text(encoding="utf-8"))
    references = re.findall(r"""(?:src|href|action|poster)\s*=\s*["']?([^"'\s>]+)""", html)
    assert references
    beside = {"figures.csv", "height.npz", "slopes.npz", "correspondence.npz"}
    assert {r for r in references if not r.startswith(("#", "data:"))} <= beside
    assert not re.search(r"https?://|@import|url\(|fetch\(|XMLHttpRequest|WebSocket", html)


def test_demo_page_has_everything(demo_page: Path, demo: DemoResult, browser: Browser) -> None:
    dom = browser(demo_page, "--dump-dom")
    assert 'data-viewer="ready"' in dom
    for name in DEMO_IDS:
        assert f'id="{name}"' in dom, name
    for n in range(1, len(demo.sequence) + 1):
        assert f'alt="pattern {n}"' in dom
        assert f'alt="camera frame {n}"' in dom
    for stage in ("trace", "capture", "decode", "reconstruct", "report", "total"):
        assert f"<span>{stage}</span>" in dom


@pytest.mark.slow
def test_surface_is_drawn_turns_and_takes_colours(demo_page: Path, tmp_path: Path, browser: Browser) -> None:
    page = tmp_path / "turn.html"
    html = demo_page.read_text(encoding="utf-8")
    page.write_text(
        html.replace("<head>", "<head>" + FRAMES).replace("</body>", TURN + "</body>"), encoding="utf-8"
    )
    dom = browser(page, "--dump-dom", "--virtual-time-budget=5000")
    assert 'data-turned="true"' in dom
    assert 'data-recoloured="true"' in dom


def test_words_and_notices_of_a_run_cannot_break_the_page(demo_page: Path) -> None:
    html = demo_page.read_text(encoding="utf-8")
    assert html.count("slopes &lt;contradict&gt; each other (9, at most 1.5 is normal): calibrate") == 1
    assert "<script>alert" not in html
    assert "&lt;script&gt;alert" in html
