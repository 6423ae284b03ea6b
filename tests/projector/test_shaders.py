"""Shader files: includes, flags, values, line numbers; and that a scene compiles only what it has."""

from dataclasses import replace

import moderngl
import pytest

from optolever.patterns import sequence
from optolever.projector.groups import frame_groups
from optolever.projector.optics_gl import look_source, trace_source
from optolever.projector.shaders import ShaderError, ShaderSource, build_source, compile_program
from optolever.projector.surface_gl import load_surface
from optolever.scene import Medium, Scene, dent, dent_names, load


def scenes(ctx: moderngl.Context, scene: Scene, name: str) -> tuple[str, str]:
    """The sources that trace `name` in a scene and look up a stripe."""
    surface = load_surface(ctx, scene, dent(name, scene))
    group = frame_groups(sequence("gray", scene.pattern.rows, scene.pattern.cols, axes="u"), None)[0]
    return trace_source(scene, surface, edges=False).text, look_source(scene, group, 1).text


def without_blur(scene: Scene, medium: Medium | None) -> Scene:
    return replace(scene, pattern=replace(scene.pattern, blur_px=0.0), medium=medium)


def test_minimal_scene_compiles_no_code_for_what_is_absent(gl: moderngl.Context) -> None:
    scene = without_blur(load("paper-simulation"), None)
    trace, look = scenes(gl, scene, "flat")
    for word in ("reflectance", "march", "coefficients", "taper", "directions"):
        assert word not in trace
    for word in ("uniform float blur", "exp(", "table_v", "response"):
        assert word not in look


@pytest.mark.parametrize("name", [name for name in dent_names() if name != "relief"])
def test_a_dent_compiles_its_own_form_only(gl: moderngl.Context, name: str) -> None:
    trace, _ = scenes(gl, load("paper-simulation"), name)
    assert trace.count("vec3 surface(vec2 at)") == 1
    assert ("arc_cosecant" in trace) == (name == "ball")
    assert ("march" in trace) == (name != "flat")


def test_what_a_scene_has_is_compiled(gl: moderngl.Context) -> None:
    trace, look = scenes(gl, replace(load("monitor-mirror"), medium=Medium(1.5)), "gaussian")
    assert "index_ratio" in trace
    assert "uniform sampler2D directions" in trace
    assert "uniform float blur" in look


def test_no_directive_of_ours_reaches_the_driver(gl: moderngl.Context) -> None:
    for text in scenes(gl, load("prism48"), "needle"):
        assert text.startswith("#version 330 core\n#line 1 0\n")
        for directive in ("#include", "#ifdef", "#else", "#endif", "$"):
            assert directive not in text


@pytest.mark.parametrize(
    ("name", "flags", "values", "words"),
    [
        ("no-such.glsl", {}, {}, ("no-such.glsl", "does not exist", "trace.glsl")),
        ("footprint.glsl", {}, {}, ("footprint.glsl", "BLUR", "not given")),
        ("footprint.glsl", {"BLUR": False}, {}, ("SHARP_FLOOR", "not given")),
        ("screen.glsl", {"BLURR": True}, {}, ("BLURR", "screen.glsl")),
        ("screen.glsl", {}, {"QUADS": 1}, ("QUADS", "screen.glsl")),
    ],
)
def test_unknown_names_are_errors(
    name: str, flags: dict[str, bool], values: dict[str, object], words: tuple[str, ...]
) -> None:
    with pytest.raises(ShaderError) as caught:
        build_source(name, flags, values)
    for word in words:
        assert word in str(caught.value)


def test_driver_errors_name_file_and_line(gl: moderngl.Context) -> None:
    source = build_source(
        "look.glsl",
        {"BLUR": False, "BOTH": False, "MEAN": False, "ALONG_U": True},
        {"QUADS": 1, "SHARP_FLOOR": 0.001},
    )
    lines = source.text.splitlines()
    at = next(i for i, line in enumerate(lines) if "float share(" in line)
    broken = ShaderSource(
        "\n".join([*lines[:at], lines[at].replace("float share", "flaot share"), *lines[at + 1 :]]),
        source.files,
    )
    number = next(
        i for i, line in enumerate(build_lines("footprint.glsl"), start=1) if line.startswith("float share(")
    )
    with pytest.raises(ShaderError, match=rf"footprint\.glsl:{number}\b"):
        compile_program(gl, broken)


def build_lines(name: str) -> list[str]:
    """The lines of a shader file."""
    from importlib.resources import files

    return (files("optolever.projector") / "shaders" / name).read_text().splitlines()


def test_locate_understands_other_drivers() -> None:
    source = ShaderSource("", ("look.glsl", "footprint.glsl"))
    assert source.locate("1(12) : error C1503") == "footprint.glsl:12 : error C1503"
    assert source.locate("ERROR: 0:7: 'x'") == "ERROR: look.glsl:7: 'x'"
    assert source.locate("9:7(3): error") == "9:7(3): error"
