"""The page of a measurement: its words, its numbers and maps against the files beside it, its read-out."""

import base64
import csv
import json
import re
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

from optolever.cli import run
from optolever.decode import Correspondence
from optolever.experiments import Measurement, write_measurement_report
from optolever.metrology import fit_form
from optolever.reconstruct import HeightMap
from optolever.scene import Accuracy, Covariance, Scene, dent, load, resize, trace

Browser = Callable[..., str]
Floats = NDArray[np.float64]
UNITS = {"nm": 1e-6, "µm": 1e-3, "mm": 1.0}
POWERS = str.maketrans("⁻⁰¹²³⁴⁵⁶⁷⁸⁹", "-0123456789")
SIZE = ("--pixels", "80x64")


@dataclass(frozen=True)
class Page:
    """A folder with a page, and the files that the page is of."""

    folder: Path
    files: Path

    @property
    def html(self) -> str:
        return (self.folder / "report.html").read_text(encoding="utf-8")

    def block(self, name: str) -> Any:
        """A JSON block of the page."""
        (text,) = re.findall(rf'<script type="application/json" id="{name}">(.*?)</script>', self.html, re.S)
        return json.loads(text)

    def figures(self) -> dict[str, tuple[float, float, str]]:
        """Value, sigma and unit by name, from the file."""
        with (self.folder / "figures.csv").open(encoding="utf-8") as stream:
            rows = list(csv.DictReader(stream))
        return {row["name"]: (float(row["value"]), float(row["sigma"] or "nan"), row["unit"]) for row in rows}

    def layer(self, name: str, model: str = "mirror") -> tuple[Floats, NDArray[np.int32], float]:
        """Samples of a layer, the camera pixel (flat index, -1: none) of each, and its unit in mm."""
        data = self.block("map-data")[model]
        (found,) = (each for each in data["layers"] if each["name"] == name)
        pixel = np.frombuffer(base64.b64decode(data["pixel"]), "<i4")
        samples = np.frombuffer(base64.b64decode(found["data"]), "<f4").astype(float)
        return samples, pixel, UNITS.get(found["unit"], 1.0)


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
    given = ("--correspondence", folder / "c-one.npz", "--capture", folder / "one")
    also = ("--scene", "monitor-mirror", "--less", folder / "two.npz", "--out", folder / "page")
    optolever("report", folder / "one.npz", *given, *also)
    return Page(folder / "page", folder)


def shown_number(text: str) -> tuple[float, float, float]:
    """A number as a page prints it: value, half a unit of its last digit, sigma (NaN: none); lengths in
    mm."""
    text = text.replace("−", "-").translate(POWERS).replace(" × 10", "e")
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


def test_maps_are_samples_of_the_files(mirror: Page) -> None:
    """Also for the difference; and the deviation's file is the height less the form."""
    with np.load(mirror.folder / "height.npz") as height, np.load(mirror.folder / "deviation.npz") as form:
        z, bent = height["z"], form["residual"]
    one, two = (HeightMap.load(mirror.files / f"{name}.npz") for name in ("one", "two"))
    change, sigma = one.difference(two)
    layers = {"height": z, "deviation": bent, "one − two": change, "sigma of one − two": sigma}
    for name, wanted in layers.items():
        samples, pixel, unit = mirror.layer(name)
        known = pixel >= 0
        assert known.sum() > 0.7 * z.size
        expected = np.asarray(wanted, np.float64).ravel()[pixel[known]]
        np.testing.assert_allclose(samples[known] * unit, expected, rtol=3e-7)
        assert np.isnan(samples[~known]).all()


def test_a_mirror_has_a_deviation_and_no_dent(mirror: Page) -> None:
    html = mirror.html
    words = re.sub(r"<(script|style|pre).*?</\1>", "", html, flags=re.S)
    assert "simulated, rig monitor-mirror, typed numbers, not calibrated" in words
    for word in ("into the medium", "Dents and contacts", "depth of the dent", "deepest"):
        assert word not in words
    assert 'id="form-table"' in words
    fit = fit_form(HeightMap.load(mirror.files / "one.npz"), "sphere")
    assert mirror.figures()["deviation rms"][0] == pytest.approx(fit.rms)


def test_sigma_of_the_deviation_is_that_of_the_fit_to_moved_maps(mirror: Page) -> None:
    """Brute force: the map moved by a thousandth of each mode of the rig, fitted again."""
    height = HeightMap.load(mirror.files / "one.npz")
    assert height.calibration is not None
    still, variance = fit_form(height, "sphere").residual, np.square(height.sigma)
    for mode in height.calibration:
        moved = fit_form(replace(height, z=height.z + 1e-3 * mode), "sphere").residual
        variance = variance + np.square(1e3 * (moved - still))
    samples, pixel, unit = mirror.layer("sigma of the deviation")
    expected = np.sqrt(variance).ravel()[pixel[pixel >= 0]]
    found = samples[pixel >= 0] * unit
    assert np.median(found) < 0.1 * np.median(height.calibration_sigma[height.good])
    assert np.abs(found - expected).max() < 0.01 * expected.max()


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
    ("day", "words"),
    [
        ("2026-11-28", "measured, rig rig.toml, calibrated on 2026-11-28"),
        ("", "measured, rig rig.toml, calibrated on a day that its file does not name"),
        (None, "measured, rig rig.toml, typed numbers, not calibrated"),
    ],
)
def test_the_header_names_the_rig_and_the_day(
    day: str | None, words: str, mirror: Page, tmp_path: Path
) -> None:
    scene: Scene = resize(load("monitor-mirror"), 64, 80)
    if day is not None:
        scene = replace(scene, covariance=Covariance(("pattern.z",), np.array([[1e-4]]), date=day))
    scene.save(tmp_path / "rig.toml")
    height = HeightMap.load(mirror.files / "one.npz")
    given = Measurement(height, scene=load(tmp_path / "rig.toml"), rig="rig.toml")
    write_measurement_report(tmp_path / "report.html", given)
    assert f'<strong id="provenance">{words}</strong>' in (tmp_path / "report.html").read_text("utf-8")


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("--remove", "egg"), "form 'egg': unknown, must be one of"),
        (("--scene", "prism48", "--less", "{files}/c-one.npz"), "c-one.npz"),
    ],
)
def test_a_mistake_is_one_line_and_leaves_no_page(
    words: tuple[str, ...], message: str, mirror: Page, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    given = [word.format(files=mirror.files) for word in words]
    source, out = str(mirror.files / "one.npz"), str(tmp_path / "page")
    assert run(["report", source, *given, "--out", out]) == 2
    (line,) = capfd.readouterr().err.strip().splitlines()
    assert message in line
    assert not (tmp_path / "page").exists()


def test_forms_and_several_maps_by_name(mirror: Page, tmp_path: Path) -> None:
    """Maps whose files share a name are told apart by their folders."""
    twin = tmp_path / "one.npz"
    twin.write_bytes((mirror.files / "two.npz").read_bytes())
    less = ("--less", mirror.files / "two.npz", "--less", twin)
    words = ("--remove", "tilt", "--out", tmp_path / "page")
    optolever("report", mirror.files / "one.npz", *less, *words)
    page = Page(tmp_path / "page", tmp_path)
    figures = page.figures()
    assert "tilt piston" in figures
    rows = [name for name in figures if name.endswith(", rms") and " − " in name]
    assert len(rows) == 2
    assert figures[rows[0]][0] == figures[rows[1]][0]
    assert not any(name.startswith("depth of the dent") for name in figures)
    optolever("report", mirror.files / "one.npz", "--remove", "none", "--out", tmp_path / "page")
    assert "deviation rms" not in page.figures()


def test_slopes_and_dents_are_less_rest(tmp_path: Path) -> None:
    """On a page as by reconstruct, from a rig whose camera is 0.3 degrees off: against the true slopes."""
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
    numbers = tmp_path / "h.json", tmp_path / "s.npz"
    out = ("--out", tmp_path / "h.npz", "--json", numbers[0], "--slopes", numbers[1])
    optolever("reconstruct", press, *scene, *rest, *out)
    known = ("report", tmp_path / "h.npz", "--correspondence", press, *scene)
    errors = {}
    for name, words in (("with", rest), ("without", ())):
        optolever(*known, *words, "--out", tmp_path / name)
        with np.load(tmp_path / name / "slopes.npz") as slopes:
            good = slopes["flags"] == 0
            exact = surface.gradient(slopes["x"], slopes["y"])
            errors[name] = [
                np.sqrt(np.mean((slopes[f"slope_{a}"] - exact[k])[good] ** 2)) for k, a in enumerate("xy")
            ]
        with np.load(numbers[1]) as slopes:
            by_command = [
                np.sqrt(np.mean((slopes[f"slope_{a}"] - exact[k])[good] ** 2)) for k, a in enumerate("xy")
            ]
        page = Page(tmp_path / name, tmp_path)
        assert ("The heights are less a rest capture" in page.html) == (name == "without")
    assert by_command == pytest.approx(errors["with"], rel=1e-3)
    assert errors["with"][0] < 0.1 * errors["without"][0]
    (contact,) = json.loads(numbers[0].read_text())["contacts"]
    depth = Page(tmp_path / "with", tmp_path).figures()["dent 1 depth"]
    assert depth[:2] == pytest.approx((contact["depth"], contact["depth_sigma"]))


def test_a_map_without_a_good_pixel_has_a_page(mirror: Page, tmp_path: Path, browser: Browser) -> None:
    height = HeightMap.load(mirror.files / "one.npz")
    nothing = replace(height, z=np.full(height.z.shape, np.nan), flags=np.ones_like(height.flags))
    write_measurement_report(tmp_path / "report.html", Measurement(nothing))
    assert 'data-charts="ready"' in browser(tmp_path / "report.html", "--dump-dom", *LOGGING)


LOGGING = ("--enable-logging=stderr", "--v=0", "--host-resolver-rules=MAP * ~NOTFOUND")
#: Behind the scripts of the page: what a reader does, and what the page then says, into the document's title.
READ = """<script>
setTimeout(() => {
  const over = document.querySelector("#height-map .u-over"), box = over.getBoundingClientRect();
  const send = (kind, x, y, to = over) => to.dispatchEvent(new MouseEvent(kind, {
    clientX: box.left + x * box.width, clientY: box.top + y * box.height, bubbles: true, view: window,
    buttons: kind === "mouseup" ? 0 : 1 }));
  const chart = (name) => document.querySelector(`#profile-${name} canvas`).toDataURL();
  const before = { x: chart("x"), line: chart("line") };
  const out = {};
  send("mousemove", 0.5, 0.5);
  setTimeout(() => {
    out.readout = document.querySelector("#height-map .readout").textContent;
    send("mousedown", 0.3, 0.7); send("mouseup", 0.3, 0.7);
    document.getElementById("draw-line").checked = true;
    send("mousedown", 0.2, 0.2); send("mouseup", 0.6, 0.4);
    setTimeout(() => {
      out.through = document.querySelector("#profile-x .u-title").textContent;
      out.moved = chart("x") !== before.x;
      out.drawn = chart("line") !== before.line;
      const select = document.getElementById("layer");
      select.value = "slope y"; select.dispatchEvent(new Event("change"));
      setTimeout(() => {
        const canvas = document.querySelector("#height-map canvas"), ground = canvas.getBoundingClientRect();
        const scale = canvas.width / ground.width;
        const image = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height).data;
        out.colours = [[0.5533, 0.2533], [0.5533, 0.6033], [0.4033, 0.6033]].map(([x, y]) => {
          const col = Math.floor(scale * (box.left - ground.left + x * box.width));
          const row = Math.floor(scale * (box.top - ground.top + y * box.height));
          return [x, y, [...image.slice(4 * (row * canvas.width + col)).slice(0, 3)]];
        });
        out.layer = document.querySelector("#height-map .map-head strong").textContent;
        const block = document.createElement("script");
        block.type = "application/json"; block.id = "result"; block.textContent = JSON.stringify(out);
        document.body.append(block);
      }, 200);
    }, 200);
  }, 200);
}, 500);
</script>"""
FRAMES = "<script>window.requestAnimationFrame = (draw) => setTimeout(draw, 1);</script>"


def read_by(browser: Browser, page: Page, folder: Path, width: int, *options: str) -> dict[str, Any]:
    """What a reader's browser of that width shows."""
    copy = folder / "read.html"
    html = page.html.replace("<head>", "<head>" + FRAMES).replace("</body>", READ + "</body>")
    copy.write_text(html, encoding="utf-8")
    size = f"--window-size={width},1200"
    dom = browser(copy, "--dump-dom", "--virtual-time-budget=6000", size, *LOGGING, *options)
    (text,) = re.findall(r'<script type="application/json" id="result">(.*?)</script>', dom, re.S)
    found: dict[str, Any] = json.loads(text.replace("&lt;", "<").replace("&gt;", ">").replace("&amp;", "&"))
    return found


@pytest.mark.slow
def test_a_reader_gets_numbers_profiles_and_a_line(mirror: Page, tmp_path: Path, browser: Browser) -> None:
    """The read-out in the middle is that of the camera pixel which it names."""
    found = read_by(browser, mirror, tmp_path, 1400)
    match = re.search(
        r"camera pixel row (\d+), column (\d+): deviation (\S+) µm; .*; height (\S+) µm", found["readout"]
    )
    assert match, found["readout"]
    row, col = int(match[1]), int(match[2])
    with np.load(mirror.folder / "height.npz") as height, np.load(mirror.folder / "deviation.npz") as form:
        for text, values in ((match[3], form["residual"]), (match[4], height["z"])):
            shown = float(text.replace("−", "-"))
            assert shown == pytest.approx(1e3 * float(values[row, col]), rel=1e-6)
        assert height["x"][row, col] == pytest.approx(75, abs=3)
    y = re.fullmatch(r"y = (\S+) mm", found["through"])
    assert y
    assert float(y[1]) == pytest.approx(55 - 0.2 * 105, abs=3)
    assert found["moved"]
    assert found["drawn"]
    assert found["layer"] == "slope y [mrad]"
    model = mirror.block("map-data")["mirror"]
    (layer,) = (each for each in model["layers"] if each["name"] == "slope y")
    samples = mirror.layer("slope y")[0].reshape(model["ny"], model["nx"])
    lut = np.frombuffer(base64.b64decode(model["luts"]["RdBu_r"]), np.uint8).reshape(256, 3).astype(int)
    for x, y, drawn in found["colours"]:
        row, col = int((1 - y) * model["ny"]), int(x * model["nx"])
        share = (samples[row, col] - layer["low"]) / (layer["high"] - layer["low"])
        wanted = lut[round(255 * min(max(share, 0.0), 1.0))]
        assert np.abs(wanted - drawn).max() <= 2, (x, y)


@pytest.mark.slow
def test_the_largest_page_is_small_and_logs_nothing(tmp_path: Path, browser: Browser) -> None:
    """A full demo: at most 8 MB, maps of at most 0.5 Mpx, no error on the console, no network."""
    optolever("demo", "--out", tmp_path, "--renderer", "numpy")
    page = Page(tmp_path, tmp_path)
    assert (tmp_path / "report.html").stat().st_size <= 8e6
    for model in page.block("map-data").values():
        assert model["nx"] * model["ny"] <= 500_000
    assert "simulated, geometry known" in page.html
    dom = browser(tmp_path / "report.html", "--dump-dom", *LOGGING)
    assert 'data-charts="ready"' in dom
    assert 'data-viewer="ready"' in dom
