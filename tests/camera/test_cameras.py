"""Back-ends of cameras: V4L2 on recorded structures, Aravis against its fake camera, addresses; one chain of
window, frame buffer, crystal, optics, GigE Vision, synchronisation, decoder and height."""

import ctypes
import errno
import json
import shutil
import struct
import subprocess
import sys
from dataclasses import dataclass, field
from importlib.util import find_spec
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from optolever import InputError
from optolever.camera import ClockMap, Timing, acquire
from optolever.camera.cameras import StillCamera, aravis, find_cameras, ioctl, open_camera, webcam
from optolever.camera.cameras.aravis import AravisCamera
from optolever.camera.cameras.pixel_formats import mosaic_of, unpacked
from optolever.camera.cameras.v4l2 import V4L2Camera
from optolever.patterns import sequence
from optolever.projector import Camera, CameraLost, Identity, Image, RealTime, Wanted, capture
from optolever.scene import dent, load, resize

CURE = "raw, or grey patterns"


@dataclass
class RecordedDevice:
    """Answers as the kernel's vivid driver did (vivid_vm.sh, 2026-11-28), but for what a test changes."""

    capabilities: int = 0x85200005
    fourccs: tuple[bytes, ...] = (b"YUYV", b"GREY", b"Y16 ")
    controls: dict[int, tuple[str, int, int, int]] = field(default_factory=dict)  # name, low, high, value
    stuck: tuple[int, ...] = ()
    fault: int = 0
    sizes: tuple[tuple[int, int, int], ...] = ()  # rows, cols, images a second
    streaming: bool = False
    sequences: tuple[int, ...] = (0, 1, 4)
    flags: int = 0x2000
    used: int | None = None
    rows: int = 6
    cols: int = 8
    taken: int = 0
    memory: bytearray = field(default_factory=bytearray)
    fourcc: bytes = b""

    def ioctl(self, request: int, data: bytearray) -> None:
        if request == ioctl.QUERYCAP:
            struct.pack_into("<I", data, 88, self.capabilities)
        elif request == ioctl.ENUM_FMT:
            (index,) = struct.unpack_from("<I", data)
            if index >= len(self.fourccs):
                raise OSError(errno.EINVAL, "Invalid argument")
            data[44:48] = self.fourccs[index]
        elif request == ioctl.S_FMT:
            if self.streaming:
                raise OSError(errno.EBUSY, "Device or resource busy")
            cols, rows, self.fourcc = *struct.unpack_from("<II", data, 8), bytes(data[16:20])
            if self.sizes:
                self.rows, self.cols = rows, cols
            width = {b"YUYV": 2, b"UYVY": 2, b"Y16 ": 2, b"RGB3": 3, b"BGR3": 3}.get(self.fourcc, 1)
            stride = width * self.cols + 4  # drivers pad rows
            given = self.cols, self.rows, self.fourcc, 1, stride, stride * self.rows
            struct.pack_into("<II4sIII", data, 8, *given)
            self.memory = bytearray(np.random.default_rng(0).bytes(stride * self.rows))
        elif request == ioctl.QUERYCTRL:
            (number,) = struct.unpack_from("<I", data)
            if number not in self.controls:
                raise OSError(errno.EINVAL, "Invalid argument")
            name, low, high, value = self.controls[number]
            data[8 : 8 + len(name)] = name.encode()
            struct.pack_into("<iiiiI", data, 40, low, high, 1, value, 0)
        elif request in (ioctl.S_CTRL, ioctl.G_CTRL):
            number, value = struct.unpack("<Ii", data)
            name, low, high, _ = self.controls[number]
            if request == ioctl.S_CTRL and number not in self.stuck:
                self.controls[number] = name, low, high, value
            elif request == ioctl.G_CTRL:
                struct.pack_into("<i", data, 4, self.controls[number][3])
        elif request == ioctl.ENUM_FRAMESIZES:
            (index,) = struct.unpack_from("<I", data)
            if index >= len(self.sizes):
                raise OSError(errno.EINVAL, "Invalid argument")
            struct.pack_into("<III", data, 8, 1, *self.sizes[index][1::-1])
        elif request == ioctl.S_PARM:
            rates = {size: fps for *size_, fps in self.sizes for size in [tuple(size_)]}
            rate = rates.get((self.rows, self.cols), 25)
            struct.pack_into("<II", data, 12, 1, 3 * rate if self.fourcc == b"MJPG" else rate)
        elif request == ioctl.REQBUFS:
            struct.pack_into("<I", data, 0, min(struct.unpack_from("<I", data)[0], 2))
        elif request == ioctl.QUERYBUF:
            struct.pack_into("<I", data, 72, len(self.memory))
        elif request == ioctl.DQBUF:
            if self.fault:
                raise OSError(self.fault, "fault")
            number = self.sequences[self.taken]
            self.taken += 1
            used = len(self.memory) if self.used is None else self.used
            struct.pack_into("<IIII", data, 0, number % 2, 1, used, self.flags)
            struct.pack_into("<qq", data, 24, 7, 250_000)
            struct.pack_into("<I", data, 56, number)

    def map(self, length: int, offset: int) -> memoryview:
        return memoryview(self.memory)

    def readable(self, timeout_s: float) -> bool:
        return self.taken < len(self.sequences)

    def close(self) -> None:
        pass


WEBCAM = {
    0x9A0901: ("Auto Exposure", 0, 3, 3),
    0x9A0902: ("Exposure Time, Absolute", 3, 2047, 250),
    0x9A0903: ("Exposure, Dynamic Framerate", 0, 1, 1),
    0x980913: ("Gain", 0, 100, 0),
}


def taken(camera: Camera, timeout_s: float = 1.0) -> Image:
    """An image that came."""
    image = camera.next(timeout_s)
    assert image is not None
    return image


FAST = Timing(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.01, 0.01)


def test_numbers_are_those_of_the_kernel() -> None:
    """As the C compiler computes them from linux/videodev2.h on x86-64."""
    expected = {"QUERYCAP": 0x80685600, "S_FMT": 0xC0D05605, "DQBUF": 0xC0585611, "QUERYCTRL": 0xC0445624}
    assert {name: getattr(ioctl, name) for name in expected} == expected


@pytest.mark.parametrize(("fourcc", "bits"), [(b"NV12", 8), (b"YUYV", 8), (b"UYVY", 8), (b"Y16 ", 16)])
def test_v4l2_images_are_the_bytes_of_the_driver(fourcc: bytes, bits: int) -> None:
    device = RecordedDevice(fourccs=(fourcc,))
    camera = V4L2Camera(device, "/dev/video0")
    accepted = camera.configure(Wanted(0.01, bits=bits))
    assert (accepted.rows, accepted.cols, accepted.bits, accepted.fps) == (6, 8, bits, 25.0)
    assert accepted.unlocked == ("exposure: the driver has no control",)
    camera.start()
    image = taken(camera)
    rows = np.frombuffer(device.memory, np.uint8).reshape(6, -1)
    expected = {
        b"NV12": rows[:, :8],
        b"YUYV": rows[:, 0:16:2],
        b"UYVY": rows[:, 1:16:2],
        b"Y16 ": rows[:, :16].copy().view("<u2"),
    }[fourcc]
    np.testing.assert_array_equal(image.pixels, expected)
    assert (image.id, image.device_s, image.complete) == (0, 7.25, True)
    taken(camera), taken(camera)
    assert camera.lost == 2  # sequence 1 -> 4
    assert camera.next(0.0) is None


@pytest.mark.parametrize(
    ("fourcc", "mosaic"),
    [(b"BA81", "BGGR"), (b"GRBG", "GRBG"), (b"RGB3", "RGB"), (b"BGR3", "RGB"), (b"YUYV", "YUYV")],
)
def test_v4l2_colours_are_the_bytes_of_the_driver(fourcc: bytes, mosaic: str) -> None:
    device = RecordedDevice(fourccs=(b"MJPG", fourcc))
    camera = V4L2Camera(device, "/dev/video0")
    accepted = camera.configure(Wanted(0.01, colour=True))
    camera.start()
    pixels, rows = taken(camera).pixels, np.frombuffer(device.memory, np.uint8).reshape(6, -1)
    assert (accepted.mosaic, (accepted.rows, accepted.cols)) == (mosaic, pixels.shape[:2])
    if fourcc != b"YUYV":
        expected = rows[:, :8] if pixels.ndim == 2 else rows[:, :24].reshape(6, 8, 3)
        np.testing.assert_array_equal(pixels, expected[..., ::-1] if fourcc == b"BGR3" else expected)
        return
    assert any("binned 2 x 2" in one for one in accepted.unlocked)
    y, cb, cr = rows[:, 0:16:2].astype(float), rows[:, 1:16:4] - 128.0, rows[:, 3:16:4] - 128.0
    y, cb, cr = 1.164 * np.maximum(y - 16, 0), np.repeat(cb, 2, axis=1), np.repeat(cr, 2, axis=1)  # BT.601
    light = np.stack([y + 1.596 * cr, y - 0.392 * cb - 0.813 * cr, y + 2.017 * cb], axis=-1).clip(0, 255)
    means = light.reshape(3, 2, 4, 2, 3).mean(axis=(1, 3))
    assert np.abs(pixels - means).max() < 2


@pytest.mark.parametrize(
    ("fourccs", "bits"),
    [
        pytest.param((b"MJPG", b"NV12"), 8, id="MJPG"),
        pytest.param((b"UYVY",), 8, id="UYVY"),
        pytest.param((b"RG10", b"BA12"), 8, id="raw of 10 and 12 bits"),
        pytest.param((b"pRAA", b"pgCC"), 8, id="packed raw of 10 and 12 bits"),
        pytest.param((b"RGGB",), 12, id="raw of 8 bits, 12 asked for"),
    ],
)
def test_formats_that_hold_no_raw_colours_are_refused_with_a_cure(
    fourccs: tuple[bytes, ...], bits: int
) -> None:
    names = " ".join(one.decode() for one in fourccs)
    said = f"camera: /dev/video0 has no format of raw colours of {bits} bits, it has {names}; {CURE}"
    with pytest.raises(InputError) as caught:
        V4L2Camera(RecordedDevice(fourccs=fourccs), "/dev/video0").configure(
            Wanted(0.01, bits=bits, colour=True)
        )
    assert str(caught.value) == said


def test_a_format_that_is_asked_for_is_no_way_around() -> None:
    for fourccs, wanted, said in (
        ((b"RGGB",), Wanted(0.01), "no grey format of 8 bits, it has RGGB; .*--colour"),
        ((b"MJPG", b"YUYV"), Wanted(0.01, format="MJPG", colour=True), f"it has MJPG YUYV; {CURE}$"),
    ):
        with pytest.raises(InputError, match=said):
            V4L2Camera(RecordedDevice(fourccs=fourccs), "/dev/video0").configure(wanted)


@pytest.mark.parametrize("bits", [10, 12, 16])
def test_aravis_refuses_raw_colours_that_its_camera_packs_or_lacks(bits: int) -> None:
    aravis_or_skip()
    fake = ctypes.CDLL("libaravis-0.8.so.0")
    fake.arv_enable_interface(b"Fake")
    try:
        camera = AravisCamera("Fake_1")
        said = f"^camera: Fake_1 has no format of raw colours of {bits} bits; {CURE}$"
        with pytest.raises(InputError, match=said):
            camera.configure(Wanted(0.005, bits=bits, colour=True))
        camera.close()
    finally:
        fake.arv_disable_interface(b"Fake")


def test_aravis_takes_raw_colours_of_its_fake_camera(monkeypatch: pytest.MonkeyPatch) -> None:
    """Its mosaics hold the samples of its RGB image; where a colour camera is asked for grey it is Mono8."""
    aravis_or_skip()
    fake, images = ctypes.CDLL("libaravis-0.8.so.0"), {}
    fake.arv_enable_interface(b"Fake")
    try:
        for name in ("BayerGR8", "BayerGB8", "RGB8", "Mono8"):
            monkeypatch.setitem(aravis.COLOURED, 8, (name,))
            camera = AravisCamera("Fake_1")
            accepted = camera.configure(Wanted(0.005, rows=64, cols=96, colour=name != "Mono8"))
            camera.start()
            images[name] = accepted.mosaic, taken(camera, 5.0)
            camera.close()
    finally:
        fake.arv_disable_interface(b"Fake")
    assert len({image.id for _, image in images.values()}) == 1  # the same picture
    assert images["Mono8"][0] == ""
    mosaic, colours = images["RGB8"]
    assert (mosaic, colours.pixels.shape) == ("RGB", (64, 96, 3))
    for name in ("BayerGR8", "BayerGB8"):
        mosaic, raw = images[name]
        for k, colour in enumerate(mosaic):
            part = np.s_[k // 2 :: 2, k % 2 :: 2]
            np.testing.assert_array_equal(raw.pixels[part], colours.pixels[..., "RGB".index(colour)][part])
    names = {"BayerRG8": "RGGB", "BayerBG8": "BGGR", "RGB8": "RGB", "Mono12p": ""}
    assert {name: mosaic_of(name) for name in names} == names


def test_v4l2_locks_what_is_automatic_and_reads_back() -> None:
    device = RecordedDevice(controls=dict(WEBCAM))
    camera = V4L2Camera(device, "/dev/video0")
    accepted = camera.configure(Wanted(0.5, gain=20))
    assert (device.controls[0x9A0901][3], device.controls[0x9A0903][3]) == (1, 0)
    assert accepted.exposure_s == pytest.approx(0.2047)  # the driver's limit, not what was wanted
    assert (accepted.gain, accepted.unlocked) == (20, ())
    stubborn = RecordedDevice(controls=dict(WEBCAM), stuck=(0x9A0901,))
    accepted = V4L2Camera(stubborn, "/dev/video0").configure(Wanted(0.01))
    assert accepted.unlocked == ("exposure: the driver does not hold 1",)


def test_webcams_are_judged_by_the_picture(monkeypatch: pytest.MonkeyPatch) -> None:
    """Everything that moves or distorts; a focus that is kept; one that moves although it reads back."""
    more = {
        0x9A090C: ("Focus, Automatic Continuous", 0, 1, 1),
        0x9A090A: ("Focus, Absolute", 0, 250, 35),
        0x98091B: ("Sharpness", 2, 7, 4),
        0x980910: ("Gamma", 90, 150, 120),
    }
    device = RecordedDevice(controls=WEBCAM | more, sequences=tuple(range(9)))
    accepted = V4L2Camera(device, "/dev/video0").configure(Wanted(0.01))
    assert [device.controls[number][3] for number in more] == [0, 35, 2, 100]
    assert (accepted.focus, accepted.unlocked) == (35, ())
    assert V4L2Camera(device, "/dev/video0").configure(Wanted(0.01, focus=90)).focus == 90
    pictures = iter(np.arange(64).reshape(8, 8) % divisor for divisor in (3, 4))
    monkeypatch.setattr(webcam, "latest", lambda _: next(pictures))
    (moves, *_) = V4L2Camera(device, "/dev/video0").configure(Wanted(0.01)).unlocked
    assert moves.startswith("focus: the picture still changes")


def test_v4l2_takes_compressed_images_smaller_sizes_and_survives_disturbed_ones() -> None:
    slow = RecordedDevice(fourccs=(b"MJPG",), sizes=((48, 64, 25), (480, 640, 3)))
    camera = V4L2Camera(slow, "/dev/video0")
    assert camera.configure(Wanted(0.01, rows=480, cols=640)).rows == 480
    assert camera.configure(Wanted(0.01)).rows == 48
    picture = np.add.outer(np.arange(48), 2 * np.arange(64)).astype(np.uint8)
    data = cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, 100])[1].tobytes()
    slow.memory, slow.sequences = bytearray(data), tuple(range(9))
    camera.start()
    image = taken(camera)
    assert np.abs(image.pixels.astype(int) - picture).max() <= 2
    head = data.index(b"\xff\xda") + 40
    for cut in (len(data) // 2, head, len(data) - 20):  # some cameras write the end nevertheless
        for end in (b"", b"\xff\xd9"):
            slow.memory[: cut + 2] = data[:cut] + (end or data[cut : cut + 2])
            slow.used = cut + len(end)
            assert not taken(camera).complete
    slow.fault = errno.EIO
    assert not taken(camera).complete


def test_v4l2_offers_compressed_images_where_raw_ones_are_slow() -> None:
    device = RecordedDevice(fourccs=(b"YUYV", b"MJPG"), sizes=((480, 640, 10),))
    camera = V4L2Camera(device, "/dev/video0")
    accepted = camera.configure(Wanted(0.01))
    assert (accepted.fps, accepted.format, device.fourcc) == (10.0, "YUYV", b"YUYV")
    assert any("10 images a second raw, 30 as MJPG" in one for one in accepted.unlocked)
    fast = camera.configure(Wanted(0.01, format="MJPG"))
    assert (fast.fps, fast.format, device.fourcc) == (30.0, "MJPG", b"MJPG")
    slow = camera.configure(Wanted(0.01, fps=10))
    assert not any("raw" in one for one in (*fast.unlocked, *slow.unlocked))
    with pytest.raises(InputError, match="format is 'GREY', /dev/video0 has YUYV MJPG"):
        camera.configure(Wanted(0.01, format="GREY"))


@pytest.mark.parametrize("name", ["Mono10p", "Mono12p", "Mono10Packed", "Mono12Packed"])
def test_packed_pixels_are_those_of_the_standard(name: str) -> None:
    """PFNC: p is a stream of bits, least first; Packed keeps the low bits of two pixels in a byte between."""
    bits = int(name[4:6])
    pixels = np.random.default_rng(0).integers(0, 2**bits, (6, 8), np.uint16)
    if name.endswith("p"):
        stream = (pixels.reshape(-1, 1) >> np.arange(bits)) & 1
        data = np.packbits(stream.astype(np.uint8), bitorder="little")
    else:
        one, other = pixels.reshape(-1, 2).T
        low = 2 ** (bits - 8) - 1
        packed = np.stack([one >> bits - 8, one & low | (other & low) << 4, other >> bits - 8], 1)
        data = packed.astype(np.uint8).ravel()
    np.testing.assert_array_equal(unpacked(data, (6, 8), name), pixels)


def test_v4l2_faults_are_one_line() -> None:
    with pytest.raises(InputError, match="the camera's node for metadata"):
        V4L2Camera(RecordedDevice(capabilities=0x84A00000), "/dev/video1")
    with pytest.raises(InputError, match="busy"):  # as a second program met it in the virtual machine
        V4L2Camera(RecordedDevice(streaming=True), "/dev/video0").configure(Wanted(0.01))
    with pytest.raises(InputError, match="no grey format of 12 bits, it has GREY"):
        V4L2Camera(RecordedDevice(fourccs=(b"GREY",)), "/dev/video0").configure(Wanted(0.01, bits=12))
    for fault in ({"flags": 0x2040}, {"used": 10}):
        broken = V4L2Camera(RecordedDevice(**fault), "/dev/video0")  # type: ignore[arg-type]
        broken.configure(Wanted(0.01))
        broken.start()
        image = taken(broken)
        assert (image.complete, image.pixels.size) == (False, 0)
    device = RecordedDevice()
    camera = V4L2Camera(device, "/dev/video0")
    camera.configure(Wanted(0.01))
    camera.start()
    device.fault = errno.ENODEV
    with pytest.raises(CameraLost, match="unplugged"):
        camera.next(1.0)
    camera.close()


def test_addresses_are_names() -> None:
    for address, message in (
        ("0", "must be serial:"),
        ("v4l2:0", "is a number"),
        ("v4l2:/dev/v4l/by-id/nobody", "no such path"),
        ("folder:", "must be"),
        ("serial:nobody", "serial 'nobody' is not connected"),
    ):
        with pytest.raises(InputError, match=message):
            open_camera(address)


def test_two_of_one_serial_and_a_camera_that_is_not_permitted(monkeypatch: pytest.MonkeyPatch) -> None:
    twins = [Identity("v4l2", "Cam", "7", f"v4l2:/dev/v4l/by-id/{k}") for k in "ab"]
    monkeypatch.setattr("optolever.camera.cameras.addresses.find_cameras", lambda: (twins, {}))
    with pytest.raises(InputError, match="2 have the serial '7'; name one: v4l2:/dev/v4l/by-id/a, v4l2"):
        open_camera("serial:7")

    def forbidden(path: str) -> None:
        raise PermissionError(errno.EACCES, "Permission denied", path)

    monkeypatch.setattr("optolever.camera.cameras.v4l2.OpenDevice", forbidden)
    with pytest.raises(InputError, match="no permission: add the user to the group video"):
        open_camera("v4l2:/dev/video0")


def test_opencv_reads_what_it_can_open(tmp_path: Path) -> None:
    """A film stands for a camera: its pictures in order, grey, and CameraLost some seconds after its end."""
    path = str(tmp_path / "film.avi")
    writer = cv2.VideoWriter(path, cv2.VideoWriter.fourcc(*"MJPG"), 25, (64, 48), False)
    for level in (40, 120, 200):
        writer.write(np.full((48, 64), level, np.uint8))
    writer.release()
    camera = open_camera(f"opencv:{path}")
    accepted = camera.configure(Wanted(0.01))
    assert (accepted.rows, accepted.cols) == (48, 64)
    assert any("exposure" in one for one in accepted.unlocked)
    camera.start()
    for level in (40, 120, 200):
        image = taken(camera)
        assert image.pixels.shape == (48, 64)
        assert abs(float(image.pixels.mean()) - level) < 2
    assert camera.next(1.0) is None
    with pytest.raises(InputError, match="no software trigger"):
        camera.trigger()
    camera.close()


def test_pylon_and_its_emulator(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two emulated Basler cameras: settings read back, a known test picture, failed buffers, the trigger."""
    monkeypatch.setenv("PYLON_CAMEMU", "2")
    if find_spec("pypylon") is None:
        pytest.skip("pypylon is absent (pip install 'optolever[basler]')")
    known, _ = (one.serial for one in find_cameras()[0] if one.backend == "pylon")
    camera = open_camera(f"serial:{known}")
    native = camera._camera  # type: ignore[attr-defined]
    accepted = camera.configure(Wanted(0.004, rows=48, cols=64, row=8, col=16, gain=3, fps=100.0))
    assert (accepted.rows, accepted.cols, accepted.row, accepted.col) == (48, 64, 8, 16)
    assert accepted.exposure_s == pytest.approx(0.004)
    assert accepted.gain == pytest.approx(3, abs=1e-3)
    native.TestImageSelector.Value = "Testimage1"  # a diagonal ramp, which moves along each image
    camera.start()
    for number in range(3):
        image = taken(camera, 2.0)
        assert (image.id, image.complete, image.pixels.shape) == (number, True, (48, 64))
        ramp = image.pixels.astype(int)
        assert (np.diff(ramp, axis=0) % 256 == 1).all()
        assert (np.diff(ramp, axis=1) % 256 == 1).all()
    native.ForceFailedBufferCount.Value = 1
    native.ForceFailedBuffer.Execute()
    faults = [camera.next(2.0) for _ in range(4)]
    (broken,) = [one for one in faults if one is not None and not one.complete]
    assert "incompletely" in broken.why
    camera.stop()
    assert camera.configure(Wanted(0.004, bits=12, trigger="software")).bits == 12
    camera.start()
    assert camera.next(0.2) is None
    camera.trigger()
    image = taken(camera, 2.0)
    assert image.pixels.dtype == np.uint16
    camera.stop()
    camera.close()
    with pytest.raises(InputError, match="pylon:nobody is not connected"):
        open_camera("pylon:nobody")


def test_cameras_that_are_not_there_are_cameras(tmp_path: Path) -> None:
    """Through the same capture logic, folder and virtual sensor give what they hold."""
    rig = resize(load("prism48"), 24, 32)
    shown = sequence("gray", rig.pattern.rows, rig.pattern.cols)
    expected = capture(rig, dent("gaussian", rig), shown, noise=1.0, seed=3, renderer="numpy")
    expected.save(tmp_path / "c")
    for camera in (open_camera(f"folder:{tmp_path / 'c'}"), StillCamera(expected, Identity("", "", "", ""))):
        camera.configure(Wanted(0.01))
        order = range(len(shown))
        every = list(acquire(camera, camera, FAST, order, time=RealTime(), clock=ClockMap()))
        np.testing.assert_array_equal([one.image.pixels for one in every], expected.frames)
        camera.close()


def test_a_pause_of_the_computer_makes_no_arrival_earlier(monkeypatch: pytest.MonkeyPatch) -> None:
    """Aravis has the wall clock. One that is too early would shift all stamps: the map is of the least."""
    now = [50.0]

    def read(ahead: float) -> float:
        now[0] += 0.05  # so long every look at a clock takes
        return now[0] + ahead

    clocks = SimpleNamespace(time=lambda: read(1000.0), monotonic=lambda: read(0.0))
    monkeypatch.setattr("optolever.camera.cameras.aravis.time", clocks)
    answers = {"stream_timeout_pop_buffer": 1, "buffer_get_status": 3, "buffer_get_frame_id": 7}
    answers |= {"buffer_get_timestamp": 2e9, "buffer_get_system_timestamp": 1e9 * (1000 + 49.9)}
    camera = AravisCamera.__new__(AravisCamera)
    camera._library = SimpleNamespace(call=lambda name, *_: answers.get(name))
    camera._stream, camera._last, camera._gige = 1, None, True
    image = camera.next(1.0)
    assert image is not None
    assert image.arrived_s >= 49.9


def aravis_or_skip() -> None:
    try:
        ctypes.CDLL("libaravis-0.8.so.0")
    except OSError:
        pytest.skip("Aravis is absent (Debian: apt-get install libaravis-0.8-0)")
    if shutil.which("unshare") is None or subprocess.run(["unshare", "-n", "true"], check=False).returncode:
        pytest.skip("no network namespace of our own (unshare -n): a fake camera could be another test's")


@pytest.mark.slow
def test_aravis_camera_over_loopback() -> None:
    """Found, set, read exactly, triggered, counted, refused while busy, lost, where no other can answer."""
    aravis_or_skip()
    command = f"ip link set lo up && exec {sys.executable} {Path(__file__).with_name('gige_camera.py')}"
    words = ["unshare", "-n", "sh", "-c", command]
    run = subprocess.run(words, capture_output=True, text=True, check=False, timeout=300)
    assert run.returncode == 0, run.stderr


SIZE, FRAMES, FAULTS = "120x160", 250, {"queue": 3, "lose": 0.002, "gap_every": 7}


@pytest.mark.slow
def test_the_chain_gives_what_the_virtual_sensor_gives(tmp_path: Path) -> None:
    """No frame of the wrong pattern, also of old images, lost packets and gaps; places, heights."""
    aravis_or_skip()
    if shutil.which("Xvfb") is None:
        pytest.skip("Xvfb is absent (Debian: apt-get install xvfb)")
    script = Path(__file__).with_name("loop.py")
    server = f"Xvfb :7 -screen 0 1280x1024x24 -fbdir {tmp_path} -nolisten tcp >/dev/null 2>&1 & XVFB=$!"
    run = f"DISPLAY=:7 {sys.executable} {script} {tmp_path} {SIZE} {FRAMES} '{json.dumps(FAULTS)}'; CODE=$?"
    wait = f"until [ -e {tmp_path}/Xvfb_screen0 ]; do sleep 0.1; done; sleep 1"
    command = f"ip link set lo up; {server}; {wait}; {run}; kill $XVFB; exit $CODE"
    words = ["unshare", "-n", "sh", "-c", command]
    done = subprocess.run(words, capture_output=True, text=True, check=False, timeout=400)
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-4000:]
    seen = json.loads(done.stdout.splitlines()[-1])
    assert (seen["frames"], seen["wrong"]) == (FRAMES, 0), seen
    assert seen["loop"]["u_rms"] == pytest.approx(seen["own"]["u_rms"], rel=0.05)
    assert seen["loop"]["height_rms"] == pytest.approx(seen["own"]["height_rms"], rel=0.10)
