"""Plausible mistakes: each is one line that names what is wrong, its value, what it must be, and the cure."""

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from optolever.decode import Correspondence
from optolever.patterns import Sequence
from optolever.projector import Capture
from optolever.reconstruct import HeightMap
from optolever.scene import load, resize

from .conftest import Chain, Program, Refused

#: Lines of the program, and words of the answer.
LINES = """
reconstruct {c} --scene prism48 --out {out}.npz | c.npz | 96 x 96 | 600 x 800
{solve} --anchor 900,0,0 --out {out}.npz | anchor point (900, 0, 0) | outside the image of 96 x 96
export {h} {out}.obj | .obj | .x3p
reconstruct {capture} {scene} --out {out}.npz | capture: is a folder, must be a file | capture.toml
reconstruct {c} --scene {capture} --out {out}.npz | is a folder, must be a file | scene.toml
decode {capture}/frames --out {out}.npz | no capture.toml | --sequence | --pixels
decode {capture}/frames --sequence gray+phase --out {out}.npz | --pixels is missing
decode {capture}/frames --sequence gray+phase --pixels 1920x1080 --out {out}.npz | 1920x1080 has 28 frames
simulate --scene prism48 --sequence phase:periods=16,8 --out {out} | '8' | name=value | 16/8
simulate --scene prism48 --pixels 800*600 --out {out} | '800*600' | 640x480
simulate --out {out} | --scene
calibrate {scene} flat --out {out}.toml | capture 'flat' | flat=pose.npz
calibrate {scene} ball:30={c} --out {out}.toml | target ball | ball:RADIUS,SIGMA | ball:30,0.003
calibrate {scene} flat={c} --prior pattern.zz=1 --out {out}.toml | pattern.zz | pattern.
show --monitor 99
rig new --kind prism --out {out}.toml | --mirror is missing | mm
rig new --kind prism --diagonal nan --out {out}.toml | --diagonal | 'nan' is not a finite number
rig new --kind prism --display-distance 3 --out {out}.toml | --display-distance | --kind is prism
reconstruct {c} {c} {scene} --keep-rest --out {out} | --keep-rest: is of one capture, not of 2
reconstruct {c} {scene} --rest {c} --keep-rest --out {out}.npz | --keep-rest | without --rest
show --pictures {out} | --pixels is missing
show --pictures {out} --pixels 0x5 | '0x5' | WIDTHxHEIGHT
reconstruct {h} {scene} --out {out}.npz | field 'u' is missing | it is a height map
form {c} | field 'x' is missing | it is a correspondence | decode
form {h} --profile 900,0,900,9 | meets no height | must lie in x
report {h} --rest {c} --out {out} | needs --correspondence and --scene
reconstruct {c} --scene prism48 --keep-rest --out {out}.npz | prism48 | rig new
camera measure --rig prism48 --out {out} | prism48: no such file | rig new
camera expose --rig prism48 | prism48: no such file | rig new
decode {capture} --mask {out}.png --out {out}.npz | out.png | no such file
decode {c} --out {out}.npz | is no folder of frames | --sequence
live --pixels 8x8 --headless | 8 x 8 pixels | at least 66 x 66
calibrate {scene} --out {out}.toml | TARGET=CAPTURE | --weight NEWTON=H.npz
calibrate {scene} --weight 1={h} --out {out}.toml | has no [layer]
camera replay {capture} | no recording | log.jsonl
captur | captur
decode {out}/nowhere --out {out}.npz | nowhere | no such
decode {capture} --out {folder} | is a folder
simulate --scene paper-simulation --pixels 20000x20000 {many} --out {out} | GiB
simulate {scene} --out {out}/deeper/still | deeper | does not exist
simulate {scene} --out {out} --json {out}/none/n.json | n.json
simulate {scene} --out {capture} | no empty folder
{solve} --mask {small} --out {out}.npz | 8x8
decode {capture} --mask {black} --out {out}.npz | black.png | leaves no pixel
{solve} --rest {h} --out {out}.npz | field
{solve} --mask {cut} --out {out}.npz | cut.tif | not an image | save it again
decode {capture} --mask 3,3,1 --out {out}.npz | --mask | four whole numbers
calibrate {scene} mirror={c} --out {out}.toml | flat, rest, ball, plate
calibrate {scene} flat:0={c} --out {out}.toml | greater than 0
calibrate {scene} flat={c} --without a --out {out}.toml | no such capture
calibrate {scene} flat={c} flat={c} --out {out}.toml | taken twice
calibrate --rig {rig} | targets of a prism are missing
calibrate rest=r.npz | Missing option '--scene'
camera measure --rig {rig} --set camera= --out {out} | camera is missing; give --set camera=
camera measure --rig {rig} --set speed=3 --out {out} | unknown field 'speed'
camera measure --rig {rig} --set trigger=soon --out {out} | trigger is 'soon'
reconstruct {c} --scene {comma} --out {out}.npz | comma.toml | index = 1,41 | with a point
reconstruct {c} --scene {empty} --out {out}.npz | empty.toml | mirror is missing | rig new
reconstruct {c} --scene {twice} --out {out}.npz | twice.toml | Cannot declare
reconstruct {black} {scene} --out {out}.npz | black.png | not a readable .npz | a file that optolever wrote
simulate --scene prism48 --noise -1 --out {out} | --noise | -1 | x>=0
rig new --kind prizm --out {out}.toml | 'prizm' | 'prism'
decode {capture} --lens 9 --out {out}.npz | lens_px is 9 | 0 to 4
decode {capture} --mask 0,0,999,999 --out {out}.npz | --mask 0,0,999,999 | beyond the frames
decode {capture} --profile {rig} --out {out}.npz | [profile] | --save-profile
decode {capture} --response {rig} --out {out}.npz | [response] | optolever response
form {h} --remove parabola | 'parabola' | paraboloid
form {h} --remove tilt --limit rms=50 | rms=50 | with its unit | rms=50nm
form {h} --aperture hexagon | 'hexagon' | circle, ellipse, rectangle
form {h} --aperture circle:radius=-3 | radius | above 0 mm
form {h} --rotations 0,90 | --rotations 0,90 | several maps
export {h} {out}.obj | .obj | .stl
export {h} {out}.csv --pitch 0 | --pitch | x>0
report {c} --out {out} | field 'x' is missing | it is a correspondence
live --set camera=virtual | --set | --rig
live {capture} | unexpected extra argument
response {capture} --scene {rig} | shows 2 levels | must show 3 or more
response {capture} --scene prism48 | prism48: no such file | rig new
sample prism | 'prism' | 'sensor'
design --scene prism48 --out {out}.png | .png, a chart, with --code
design --scene prism48 --code phase --fault gama=2 | 'gama=2' | lag, gamma, flicker, blur
reconstruct {capture} {scene} --out {out}.npz | is a folder | optolever decode makes an .npz of it
decode {capture} --description {minus} --out {out}.npz | minus.toml: rows is -188 | 1..65536
decode {capture} {frames} --jobs two --out {out} | --jobs two | tcp://host:8786
decode {capture} {frames} --out {out}.npz | becomes a folder, of 2 captures | leave .npz out
report {h} --less {h} --out {out} | --less | is the map | give another
report {h} --less {rested} --out {out} | one of both maps alone is less a rest capture | --rest
form {h} --limit pv=-4um | pv=-4um | above 0
form {h} --limit sag=3nm | NAME one of rms
form {h} --limit rms=3miles | rms=3miles | with its unit
form {h} --limit rms=1um --limit rms=2nm | --limit rms: has 2 limits
form {h} --aperture circle:r=3 | 'r=3' | NUMBER=VALUE of radius
form {h} --aperture ellipse:a=3 | b must be given
form {h} --aperture circle:radius=3,x=999 | contains no good pixel
form {h} --remove sphere:r=3 | 'r=3' | NUMBER=VALUE of vertex_x
form {h} --remove sphere:radius=0 | radius is 0 mm | must not be 0
form {h} --remove piston:piston=0 | every number is given
form {h} --remove power --nominal {h} | leave one out
form {h} --zernike 4:order=fringe | 'order=fringe' | index=ansi|fringe
form {h} --zernike 99 | '99' | 1 to 20
form {h} --zernike 4:index=noll | index=noll | index=ansi|fringe
form {h} --highpass 5 --lowpass 20 | must be above --lowpass 20
form {h} {h} --rotations 0 | 1 angles, must be 2
form {h} {h} --rotations 0,x | --rotations '0,x' | 0,90,180,270
form {h} {h} --zernike 4 | is of one map, not of 2
simulate --scene prism48 --dent gaussian:peak=300 --out {out} | peak = 300 | at most the mirror's size, 60 mm
design --scene prism48 --pixels 32x24 --code {folder} | holds neither | coordinates.toml
design --scene prism48 --pixels 96x72 --frames 3 | no candidate fits
design --scene prism48 --pixels 96x72 --out {out}.json | suffix '.json', must be .toml or .png
design --scene prism48 --pixels 96x72 --add nowhere:nothing | cannot be imported
"""


@pytest.fixture(scope="module")
def known(chain: Chain, tmp_path_factory: pytest.TempPathFactory) -> dict[str, object]:
    """Names of a line, most of them of files."""
    folder = tmp_path_factory.mktemp("mistakes")
    resize(load("prism48"), 48, 64).save(folder / "rig.toml")
    with (folder / "rig.toml").open("a") as file:
        file.write('\n[devices]\ncamera = "virtual"\n')
    cv2.imwrite(str(folder / "small.png"), np.full((8, 8), 255, np.uint8))
    cv2.imwrite(str(folder / "black.png"), np.zeros((96, 96), np.uint8))
    for name, text in (("comma", "[medium]\nindex = 1,41\n"), ("empty", ""), ("twice", "[mirror]\n" * 2)):
        (folder / f"{name}.toml").write_text(text)
    (folder / "minus.toml").write_text("rows = -188\ncols = 187\n[[frames]]\nkind = 'white'\n")
    height = HeightMap.load(chain.height)
    rested = replace(height, references=("rest 1",), shared=np.zeros((1, *height.z.shape)))
    rested.save(folder / "rested.npz")
    (folder / "cut.tif").write_bytes(b"II*\0\xff\0\0\0")
    return {
        **{path.stem: path for path in folder.iterdir()},
        "frames": chain.capture / "frames",
        "many": "--sequence phase:steps=64,periods=9/10/11",
        "capture": chain.capture,
        "c": chain.correspondence,
        "h": chain.height,
        "solve": f"reconstruct {chain.correspondence} --scene {chain.capture / 'scene.toml'}",
        "scene": f"--scene {chain.capture / 'scene.toml'}",
    }


@pytest.mark.parametrize("row", LINES.strip().splitlines())
def test_a_line_that_is_not_meant_so(
    row: str, refused: Refused, known: dict[str, object], tmp_path: Path
) -> None:
    """An older result is kept."""
    line, *words = row.split(" | ")
    (tmp_path / "out.npz").write_bytes(b"an older result")
    refused(line.format(**known, out=tmp_path / "out", folder=tmp_path).split(), *words)


def test_no_good_pixel_and_no_command(optolever: Program, chain: Chain, tmp_path: Path) -> None:
    """A file is written, the cause is said; alone the program shows its help."""
    shown = Capture.load(chain.capture).sequence
    Sequence(shown.frames[::-1], 70, 90).save(tmp_path / "turned.toml")
    args = ("--description", tmp_path / "turned.toml", "--out", tmp_path / "c.npz")
    said = optolever("decode", chain.capture / "frames", *args, code=2)
    assert "optolever explain names the likeliest mistake" in said.err
    assert said.err.endswith("no pixel is good\n")
    assert "nan" not in said.out
    assert not Correspondence.load(tmp_path / "c.npz").good.any()
    assert "Commands:" in optolever().out


def test_lengths_in_metres(refused: Refused, tmp_path: Path) -> None:
    scene = resize(load("prism48"), 48, 64)
    replace(scene, pattern=replace(scene.pattern, pitch=scene.pattern.pitch / 1000)).save(tmp_path / "m.toml")
    words = ("pattern.pitch_mm", "at least 0.001 mm", "multiply metres by 1000")
    refused(["simulate", "--scene", tmp_path / "m.toml", "--out", tmp_path / "c"], *words)


def test_pictures_in_colour(optolever: Program, chain: Chain, tmp_path: Path) -> None:
    """A warm white: red at 9/10, blue at 2/3."""
    folder, tint = tmp_path / "shots", np.array([2 / 3, 1, 0.9])
    folder.mkdir()
    for path in (chain.capture / "frames").iterdir():
        image = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
        coloured = np.rint(image[..., None] * tint).astype(np.uint8)
        cv2.imwrite(str(folder / f"{path.stem}.jpg"), coloured, [cv2.IMWRITE_JPEG_QUALITY, 95])
    rows, cols = Capture.load(chain.capture).sequence.shape[1:]
    args = ["--sequence", "gray+phase", "--pixels", f"{cols}x{rows}", "--out", tmp_path / "c.npz"]
    notices = optolever("decode", folder, *args).err
    assert "pictures in colour, luminance is taken" in notices
    assert "JPEG" in notices
    found, true = Correspondence.load(tmp_path / "c.npz"), Correspondence.load(chain.correspondence)
    both = found.good & true.good
    assert both.sum() > 0.9 * true.good.sum()
    assert np.abs(found.u - true.u)[both].max() < 1
