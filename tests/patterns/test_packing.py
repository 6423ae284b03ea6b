"""Sequences in colour: which frame each channel of each exposure shows."""

from collections import Counter

import cv2
import numpy as np
import pytest

from optolever import InputError
from optolever.patterns import Packing, Sequence, packed, sequence_from_text

#: Exposures on the pattern of prism48, 747 x 750 cells (3 frames each, but for whole fringes and pairs).
COUNTS = {
    "gray": 14,
    "long-run-gray": 14,
    "gray:inverses=false": 8,
    "gray+phase": 9,
    "gray+phase:inverses=true": 14,
    "gray+phase:steps=3": 8,
    "phase": 8,
    "phase:periods=9/10/11": 8,
    "phase:periods=9/10/11,steps=3": 6,
    "phase:periods=9/10/11,steps=6": 12,
    "micro-phase": 8,
    "phase:axes=u": 4,
}


def _packed(text: str) -> tuple[Sequence, np.ndarray]:
    grey = sequence_from_text(text, 747, 750)
    shown = packed(grey, "rgb" if any(frame.kind == "phase" for frame in grey) else "none")
    assert shown.packing is not None
    return shown, np.array(shown.packing.exposures)


@pytest.mark.parametrize("text", COUNTS)
def test_every_frame_is_shown_in_few_exposures_and_nothing_is_torn(text: str) -> None:
    grey, (shown, exposures) = sequence_from_text(text, 747, 750), _packed(text)
    assert Counter(grey.frames) == Counter(shown.frames)
    assert len(exposures) == COUNTS[text]
    assert set(exposures.ravel()) == set(range(len(grey)))
    channels: dict[int, set[int]] = {}
    for own in exposures:
        for channel, i in enumerate(own):
            channels.setdefault(int(i), set()).add(channel)
    together: dict[object, list[int]] = {}
    for i, frame in enumerate(shown.frames):
        ends = frame.kind in ("white", "black")
        key = "ends" if ends else (frame.kind, frame.axis, frame.bit, frame.period_px)
        together.setdefault(key, []).append(i)
    for key, index in together.items():
        assert len({c for i in index for c in channels[i]}) == 1, key
    first = [int(np.argmax((exposures == i).any(axis=1))) for i in range(len(shown))]
    for channel in range(3):
        own = [first[i] for i in range(len(shown)) if channels[i] == {channel}]
        assert own == sorted(own)  # frames are in the order of time


def test_fringes_along_u_are_red_and_along_v_blue() -> None:
    shown, exposures = _packed("gray+phase")
    for axis, channel in (("u", 0), ("v", 2)):
        own = {i for i, frame in enumerate(shown.frames) if (frame.kind, frame.axis) == ("phase", axis)}
        assert own <= set(exposures[:, channel])


@pytest.mark.parametrize("text", ["gray+phase", "phase:periods=9/10/11", "gray+phase:period=16"])
def test_a_lag_of_the_display_adds_no_phase(text: str) -> None:
    """From what the display emits, a tenth of it the exposure before: phases of every fringe but that of a
    channel's start are right on average over its places."""
    shown, exposures = _packed(text)
    place = np.arange(39600) / 40
    for fringe in {(f.axis, f.period_px) for f in shown.frames if f.kind == "phase"}:
        index = [i for i, f in enumerate(shown.frames) if (f.axis, f.period_px) == fringe]
        wave = np.zeros(place.size, complex)
        begins = False
        for i in index:
            k, channel = next(zip(*np.nonzero(exposures == i), strict=True))
            before = shown.frames[exposures[max(k - 1, 0), channel]]
            begins |= k == 0
            seen = 0.9 * shown.frames[i].ideal_levels(place, fringe[0])
            if before.axis == fringe[0]:
                seen = seen + 0.1 * before.ideal_levels(place, fringe[0])
            wave += seen * np.exp(1j * (shown.frames[i].shift or 0.0))
        # an exposure adds to the phase of a fringe with the other's period: zero mean over a place's beat
        error = np.angle(wave * np.exp(-2j * np.pi * place / fringe[1])) * fringe[1] / (2 * np.pi)
        assert begins or abs(np.mean(error)) < 0.001


@pytest.mark.parametrize(("stripes", "aside"), [("rgb", (-1 / 3, 0, 1 / 3)), ("bgr", (1 / 3, 0, -1 / 3))])
def test_fringes_are_drawn_for_the_places_of_their_stripes(
    stripes: str, aside: tuple[float, float, float]
) -> None:
    """A red stripe that lies left of its cell's centre shows what the fringe is there."""
    shown = packed(sequence_from_text("phase:periods=9/10/11", 60, 80), stripes)
    assert shown.packing is not None
    pictures, cells = np.stack(list(shown.pictures())), np.arange(80)
    for exposure, picture in zip(shown.packing.exposures, pictures, strict=True):
        for channel, i in enumerate(exposure):
            frame = shown.frames[i]
            if frame.axis == "u":
                wanted = frame.ideal_levels(cells + aside[channel], "u")
                np.testing.assert_allclose(picture[7, :, channel], wanted, atol=0.51)
            else:
                wanted = frame.ideal_levels(np.arange(60.0), "v")
                np.testing.assert_allclose(picture[:, 7, channel], wanted, atol=0.51)


def test_pictures_and_description_come_back(tmp_path) -> None:  # type: ignore[no-untyped-def]
    shown = packed(sequence_from_text("gray+phase", 40, 60), "bgr")
    shown.save_png(tmp_path / "pictures")
    assert Sequence.load(tmp_path / "pictures" / "sequence.toml") == shown
    files = sorted((tmp_path / "pictures").glob("*.png"))
    assert shown.packing is not None
    assert len(files) == len(shown.packing.exposures)
    for file, picture in zip(files, shown.pictures(), strict=True):
        np.testing.assert_array_equal(cv2.imread(str(file))[..., ::-1], picture)


@pytest.mark.parametrize("text", ["crossed", "lattice", "stripe"])
def test_other_patterns_stay_grey(text: str) -> None:
    with pytest.raises(InputError, match="shown in grey alone"):
        packed(sequence_from_text(text, 60, 80))


def test_a_packing_shows_the_frames_that_there_are() -> None:
    grey = sequence_from_text("phase:axes=u,periods=8", 6, 8)
    for exposures, wrong in [
        (((0, 1, 2),), "frame 3 is in no"),
        (((0, 1, 2), (3, 3, 4)), "frame 4 does not"),
        (((0, 1),), "three"),
    ]:
        with pytest.raises(InputError, match=wrong):
            Sequence(grey.frames, 6, 8, packing=Packing(exposures))  # type: ignore[arg-type]
    with pytest.raises(InputError, match="stripes is 'grb'"):
        packed(grey, "grb")
    with pytest.raises(InputError, match=r"bits alone along u .* add fringes"):
        packed(sequence_from_text("gray", 60, 80), "bgr")
