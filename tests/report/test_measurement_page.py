"""The pages of a measurement and of a demo: numbers and maps against the files of their folder."""

import base64
import csv
import json
import re
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from matplotlib import colormaps
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

from optolever.cli import run
from optolever.decode import Correspondence, Flag
from optolever.notices import Notice
from optolever.reconstruct import HeightFlag, HeightMap
from optolever.report import write_demo_report, write_measurement_report
from optolever.report.flag_table import MEANING
from optolever.samples import DemoResult, Measurement
from optolever.scene import Accuracy, dent, load, resize, trace

from ..cli.chromium import Chromium

Browser = Callable[..., str]
Floats = NDArray[np.float64]
UNITS = {"nm": 1e-6, "µm": 1e-3, "mm": 1.0}
POWERS = str.maketrans("⁻⁰¹²³⁴⁵⁶⁷⁸⁹", "-0123456789")
SIZE = ("--pixels", "80x64")
LOGGING = ("--enable-logging=stderr", "--v=0", "--host-resolver-rules=MAP * ~NOTFOUND")
#: On the page, as are words of the command that no page may run.
NOTICE = Notice("slopes <contradict> each other", 9.0, 1.5, "calibrate")
BAD_WORDS = "</title><script>alert(1)</script>"


@dataclass(frozen=True)
class Page:
    """A folder with a page, and the files that the page is of."""

    folder: Path
    files: Path

    @property
    def html(self) -> str:
        return (self.folder / "report.html").read_text(encoding="utf-8")

    def figures(self) -> dict[str, tuple[float, float, str]]:
        """Value, sigma and unit by name, from the file."""
        with (self.folder / "figures.csv").open(encoding="utf-8") as stream:
            rows = list(csv.DictReader(stream))
        return {row["name"]: (float(row["value"]), float(row["sigma"] or "nan"), row["unit"]) for row in rows}


def optolever(*args: str | Path) -> None:
    assert run([str(arg) for arg in args]) == 0


@pytest.fixture(scope="module")
def mirror(tmp_path_factory: pytest.TempPathFactory) -> Page:
    """Two captures of a mirror in open air, its rig typed; the page is of the first, less the second."""
    folder = tmp_path_factory.mktemp("mirror")
    scene = ("--scene", "monitor-mirror", *SIZE)
    for name, peak in (("one", "0.003"), ("two", "0.002")):
        taken = ("--dent", f"gaussian:peak={peak},sigma=15", "--noise", "1", "--renderer", "numpy")
        optolever("simulate", *scene, *taken, "--out", folder / name)
        optolever("decode", folder / name, "--out", folder / f"c-{name}.npz")
        solve = ("--anchor", "75,55,0", "--out", folder / f"{name}.npz")
        optolever("reconstruct", folder / f"c-{name}.npz", *scene, *solve)
    given = ("--correspondence", folder / "c-one.npz")
    also = ("--scene", "monitor-mirror", "--less", folder / "two.npz", "--waves", "632.8")
    also = (*also, "--out", folder / "page")
    optolever("report", folder / "one.npz", *given, *also)
    found = Correspondence.load(folder / "c-one.npz")
    replace(found, v=found.v + np.linspace(0, 3, 80)).save(folder / "bent.npz")
    replace(found, flags=np.ones_like(found.flags)).save(folder / "none.npz")
    resize(load("monitor-mirror"), 48, 64).save(folder / "small.toml")
    return Page(folder / "page", folder)


def shown_number(text: str) -> tuple[float, float, float]:
    """A number as a page prints it: value, half a unit of its last digit, sigma (NaN: none); lengths in
    mm."""
    text = text.replace("−", "-").translate(POWERS).replace(" × 10", "e")
    if "± " in text and text.endswith((" noise", " rig")):  # apart
        value, *parts = re.split(r" ± | noise(?:, ± )?| rig", text)
        number, last, _ = shown_number(value)
        return (
            number,
            last,
            float(np.hypot(*[np.nan if one == "unknown" else shown_number(one)[0] for one in parts if one])),
        )
    match = re.fullmatch(r"(-?[\d.]+(?:e-?\d+)?)(?: ± ([\d.]+(?:e-?\d+)?))? ?(.*)", text)
    assert match, text
    digits, _, power = match[1].partition("e")
    unit = {"%": 0.01, **UNITS}.get(match[3], 1.0)
    last = 10.0 ** (int(power or 0) - len(digits.partition(".")[2]))
    return float(match[1]) * unit, 0.5 * last * unit, float(match[2] or "nan") * unit


def test_every_number_agrees_with_the_file_beside_the_page(mirror: Page) -> None:
    shown = re.findall(r'<span class="figure" data-figure="([^"]*)">([^<]*)</span>', mirror.html)
    figures = mirror.figures()
    assert {name for name, _ in shown} == set(figures)
    assert len(shown) > 60
    assert "%" not in {unit for *_, unit in figures.values()}  # shares, from 0 to 1
    assert figures["deviation rms"][0] > figures["deviation rms less noise"][0] > 0
    for name, text in shown:
        value, sigma, _ = figures[name]
        if not np.isfinite(value):
            assert text == "–", name
            continue
        number, last, spread = shown_number(text)
        loose = sigma / 20 if np.isfinite(sigma) else 0.0  # two digits of sigma
        assert number == pytest.approx(value, abs=1.001 * max(last, loose), rel=1e-12), name
        if np.isfinite(spread):
            assert spread == pytest.approx(sigma, rel=0.051), name


def test_flags_add_up_to_the_mirror(mirror: Page) -> None:
    """The good area is that of the hull of the points that the camera sees at rest, and half a pixel
    around."""
    figures = mirror.figures()
    areas = [value for name, (value, _, _) in figures.items() if re.fullmatch("flag .*, area", name)]
    shares = [value for name, (value, _, _) in figures.items() if re.fullmatch("flag .*, share", name)]
    assert sum(areas) == pytest.approx(150 * 110)
    assert sum(shares) == pytest.approx(1)
    scene = resize(load("monitor-mirror"), 64, 80)
    rest = trace(scene, dent("flat", scene))
    points = np.stack([rest.x[rest.visible], rest.y[rest.visible]], axis=1)
    hull = ConvexHull(points)
    around = hull.area * 0.5 * np.sqrt(hull.volume / len(points))
    assert sum(areas) - figures["flag outside the image, area"][0] == pytest.approx(
        hull.volume + around, rel=2e-3
    )


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("--remove", "egg"), "form 'egg': unknown, must be one of"),
        (("--scene", "prism48", "--less", "{files}/c-one.npz"), "c-one.npz"),
        (("--scene", "{files}/small.toml"), "camera has 48 x 64 pixels, must be 64 x 80"),
        (("--correspondence", "{files}/none.npz"), "good pixels of the height map not"),
        (("--correspondence", "{files}/bent.npz", "--scene", "monitor-mirror"), "slopes differ"),
    ],
)
def test_a_mistake_is_one_line_and_leaves_no_page(
    words: tuple[str, ...], message: str, mirror: Page, tmp_path: Path, refused: Callable[..., str]
) -> None:
    given = [word.format(files=mirror.files) for word in words]
    refused(["report", mirror.files / "one.npz", *given, "--out", tmp_path / "page"], message)
    assert not (tmp_path / "page").exists()


def test_slopes_and_dents_are_less_rest(tmp_path: Path) -> None:
    """A rig whose camera is 0.3 degrees off: against the true slopes."""
    true = resize(load("prism48", exact=True), 60, 80)
    turned = np.array([-np.cos(np.radians(48.3)), 0.0, np.sin(np.radians(48.3))])
    typed = tmp_path / "typed.toml"
    replace(true, accuracy=Accuracy(), camera=replace(true.camera, u_axis=turned)).save(typed)
    surface = dent("gaussian", true, peak=0.3, sigma=4)
    for name, shape in (("rest", dent("flat", true)), ("press", surface)):
        light = trace(true, shape)
        one = np.full(light.u.shape, 0.01)
        flags = np.where(light.visible, 0, 1).astype(np.uint16)
        Correspondence(light.u, light.v, one, one, flags).save(tmp_path / f"{name}.npz")
    press, rest = tmp_path / "press.npz", ("--rest", tmp_path / "rest.npz")
    scene = ("--scene", typed)
    numbers = tmp_path / "h.json"
    optolever("reconstruct", press, *scene, *rest, "--out", tmp_path / "h.npz", "--json", numbers)
    known = ("report", tmp_path / "h.npz", "--correspondence", press, *scene)
    errors = []
    for name, words in (("with", rest), ("without", ())):
        optolever(*known, *words, "--full", "--out", tmp_path / name)
        with np.load(tmp_path / name / "slopes.npz") as slopes:
            good = slopes["flags"] == 0
            exact, _ = surface.gradient(slopes["x"], slopes["y"])
            errors.append(np.sqrt(np.mean((slopes["slope_x"] - exact)[good] ** 2)))
        page = Page(tmp_path / name, tmp_path)
        assert ("The heights are relative to a rest capture" in page.html) == (name == "without")
    assert errors[0] < 0.1 * errors[1]
    (contact,) = json.loads(numbers.read_text())["contacts"]
    page = next(tmp_path.rglob("*.html")).read_text(encoding="utf-8")
    ids = re.findall(r'\sid="([^"]+)"', page)
    assert "contacts" in ids
    assert len(ids) == len(set(ids)), "a section stands twice"
    depth = Page(tmp_path / "with", tmp_path).figures()["contact 1 depth"]
    assert depth[:2] == pytest.approx((contact["depth"], contact["depth_sigma"]))


@pytest.fixture(scope="module")
def demo_page(demo: DemoResult, tmp_path_factory: pytest.TempPathFactory) -> Page:
    """Of a run with a notice and a setting that hold markup."""
    folder = tmp_path_factory.mktemp("demo")
    height, settings = replace(demo.height, notices=(NOTICE,)), demo.settings | {"sequence": BAD_WORDS}
    run_ = write_demo_report(replace(demo, height=height, settings=settings), folder / "report.html")
    assert run_.seconds["report"] > 0
    return Page(folder, folder)


def test_colours_are_those_of_matplotlib(demo_page: Page) -> None:
    found = re.search(r'id="map-data">(.*?)</script>', demo_page.html, re.DOTALL)
    assert found is not None
    luts = json.loads(found[1])["mirror"]["luts"]
    assert set(luts) == {"viridis", "cividis", "RdBu_r"}
    for name, lut in luts.items():
        colours = np.round(255 * colormaps[name](np.linspace(0, 1, 256))[:, :3])
        assert list(base64.b64decode(lut)) == colours.astype(int).ravel().tolist()


def test_pages_run_and_ask_the_network_for_nothing(
    mirror: Page, demo_page: Page, tmp_path: Path, browser: Browser
) -> None:
    """Also one of a map without a good pixel; words of a run cannot break a page."""
    height = HeightMap.load(mirror.files / "one.npz")
    nothing = replace(height, z=np.full(height.z.shape, np.nan), flags=np.ones_like(height.flags))
    write_measurement_report(tmp_path / "report.html", Measurement(nothing))
    for page in (mirror, demo_page, Page(tmp_path, tmp_path)):
        text = re.sub(r"(data:[a-z/]+;base64,)?[A-Za-z0-9+/=]{200,}", "", page.html)
        assert not re.search(r"https?://|@import|url\(|fetch\(|XMLHttpRequest|WebSocket", text)
        links = re.findall(r"""(?:src|href|action|poster)\s*=\s*["']?([^"'\s>]+)""", text)
        assert all((page.folder / link).is_file() for link in links if not link.startswith(("#", "data:")))
        dom = browser(page.folder / "report.html", "--dump-dom", *LOGGING)
        assert 'data-charts="ready"' in dom
        assert 'data-viewer="ready"' in dom
        pictures = re.findall(r"<(?:img|canvas|svg)\b[^>]*>", dom)
        assert pictures
        assert all("alt=" in each or "aria-label=" in each for each in pictures)
    assert (
        demo_page.html.count("slopes &lt;contradict&gt; each other (9, at most 1.5 is normal): calibrate")
        == 1
    )
    assert "<script>alert" not in demo_page.html
    assert ">rig monitor-mirror, typed numbers, not calibrated" in mirror.html
    assert "<h2>Contacts" not in mirror.html
    assert "<h2>Contacts" in demo_page.html


#: What a sheet of paper cuts off: elements that reach beyond the page, or scroll.
CUT = """
[...document.querySelectorAll("section, table, pre, p, figure, canvas, svg, img, .scroll")]
  .filter((one) => one.getBoundingClientRect().right > innerWidth + 1 ||
    (one.matches("section, table, pre, p, .scroll") && one.scrollWidth > one.clientWidth + 1))
  .map((one) => `${one.tagName}#${one.id}.${one.className}`)"""
INK = "getComputedStyle(document.documentElement).getPropertyValue('--ink').trim()"


def test_a_page_prints_whole_and_light(mirror: Page, demo_page: Page, tmp_path: Path) -> None:
    """On at most 4 sheets of A4 from a dark browser: nothing is cut, folded parts neither once they are open,
    canvases are drawn in dark ink, and after it as before. On a screen the page is at most 2,500 px long; on
    a narrow one tables alone scroll, inside their part."""
    for page in (mirror, demo_page):
        with Chromium(tmp_path / "profile") as browser:
            browser.look(1300, True)
            browser.open((page.folder / "report.html").as_uri())
            browser.wait("document.querySelector('[data-charts=ready]')")
            assert browser.value("document.documentElement.scrollHeight") <= 2500
            dark = browser.value(INK)
            browser.value(f"window.inks = []; addEventListener('beforeprint', () => inks.push({INK}))")
            pdf = base64.b64decode(browser.call("Page.printToPDF", printBackground=True)["data"])
            assert pdf.startswith(b"%PDF")
            assert 1 <= len(re.findall(rb"/Type /Page\b", pdf)) <= 4
            assert browser.value("inks") == ["#1b2430"] != [dark]
            browser.wait(f"{INK} === '{dark}'")
            browser.value("document.querySelectorAll('details').forEach((one) => (one.open = true))")
            browser.look(390, False)
            browser.wait(f"{CUT}.every((one) => /scroll|TABLE|PRE/.test(one))")
            browser.look(718, False)  # A4 less margins of 1 cm
            browser.call("Emulation.setEmulatedMedia", media="print")
            assert browser.value(CUT) == []
            assert not browser.messages


def test_a_wavefront_on_the_page_is_twice_the_deviation(mirror: Page) -> None:
    figures = mirror.figures()
    for name in ("rms", "pv"):
        waves, deviation = figures[f"wavefront {name}"], figures[f"deviation {name}"]
        assert np.array(waves[:2]) * 632.8e-6 == pytest.approx(2 * np.array(deviation[:2]))
        assert waves[2] == "waves"


def test_words_contrast_with_their_ground() -> None:
    """WCAG 2.1, 1.4.3 (AA): 4.5, in light and in dark."""
    style = (Path(__file__).resolve().parents[2] / "report/page/style.css").read_text()

    def light(colour: str) -> float:
        shares = [int(colour[k : k + 2], 16) / 255 for k in (1, 3, 5)]
        linear = [each / 12.92 if each <= 0.04045 else ((each + 0.055) / 1.055) ** 2.4 for each in shares]
        return 0.05 + float(np.dot([0.2126, 0.7152, 0.0722], linear))

    roots = re.findall(r":root(?::not\(.print\))? \{(.*?)\}", style, re.S)
    themes = [found for each in roots if (found := dict(re.findall(r"--(\w+): (#\w{6})", each)))]
    assert len(themes) == 2
    for theme in themes:
        for word in ("ink", "soft", "accent", "good", "bad"):
            for ground in ("card", "ground"):
                one, other = light(theme[word]), light(theme[ground])
                assert max(one, other) / min(one, other) >= 4.5, (word, ground)


def test_numbers_of_a_demo_have_their_names_and_are_plain(demo: DemoResult) -> None:
    """Those that checks from outside rely on."""
    plain = json.loads(json.dumps(demo.to_dict()))
    assert {"height_rms_rel", "unflagged_share", "sigma_ratio_height", "sigma_ratio_u"} <= set(plain)
    assert {"trace", "capture", "decode", "reconstruct", "total"} <= set(plain["seconds"])
    assert plain["peak_bytes"] > 1e7
    assert all(np.isfinite(value) for value in demo.metrics.values())


def test_every_flag_has_words() -> None:
    for member in (*Flag, *HeightFlag):
        assert MEANING[str(member.name)]
