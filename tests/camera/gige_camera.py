"""Opens a GigE camera on loopback as the program does; run by test_cameras.py in a network of its own."""

import subprocess
import sys
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent))
from gige_host import GigEHost, Request

from optolever.camera.cameras import find_cameras, open_camera
from optolever.projector import Camera, CameraLost, Image, Wanted

ROWS, COLS = 120, 160


def picture(request: Request) -> np.ndarray:
    """A picture that tells its number; every seventh number is left out."""
    request.frame_id += request.frame_id // 7
    return expected(request.frame_id, request.bits)


def expected(number: int, bits: int) -> np.ndarray:
    rows, cols = np.mgrid[:ROWS, :COLS]
    return (rows * 3 + cols * 5 + number) % 2**bits


def following(camera: Camera, count: int) -> list[Image]:
    images: list[Image] = []
    limit = time.monotonic() + 30
    while len(images) < count and time.monotonic() < limit:
        images += [image for image in [camera.next(1.0)] if image is not None]
    assert len(images) == count
    return images


def main() -> None:
    with GigEHost(picture) as host:
        camera = at_work(host)
        host.stop()
        limit = time.monotonic() + 30
        try:
            while time.monotonic() < limit:
                camera.next(0.5)
            raise AssertionError("a dead camera was not noticed in 30 s")
        except CameraLost:
            camera.close()
    with GigEHost(picture):
        camera = open_camera("gige:127.0.0.1")
        camera.configure(Wanted(0.005, ROWS, COLS, fps=50))
        camera.start()
        following(camera, 3)
        camera.close()


def at_work(host: GigEHost) -> Camera:
    """Found, read exactly, triggered, incomplete, counted, busy for others; still open."""
    (one,) = [each for each in find_cameras()[0] if each.serial == "TEST-1"]
    assert one.address == "gige:127.0.0.1", one
    camera = open_camera("serial:TEST-1")
    for bits in (8, 16):
        accepted = camera.configure(Wanted(0.005, ROWS, COLS, bits=bits, fps=50))
        assert (accepted.rows, accepted.cols, accepted.bits) == (ROWS, COLS, bits), accepted
        assert abs(accepted.exposure_s - 0.005) < 1e-5, accepted
        camera.start()
        for image in following(camera, 20):
            if image.complete:
                assert image.id is not None
                np.testing.assert_array_equal(image.pixels, expected(image.id, bits))
                assert image.device_s is not None
                assert -0.05 < image.arrived_s - image.device_s < 5
        camera.stop()
    camera.configure(Wanted(0.005, ROWS, COLS, trigger="software"))
    camera.start()
    for _ in range(3):
        sent = camera.trigger()
        (image,) = following(camera, 1)
        assert image.arrived_s > sent
    assert camera.next(0.3) is None
    camera.stop()
    camera.configure(Wanted(0.005, ROWS, COLS, fps=50))
    host.lose(0.1)
    camera.start()
    broken = [image for image in following(camera, 40) if not image.complete]
    assert broken
    assert all(image.pixels.size == 0 and image.why for image in broken)
    host.lose(0.0)
    camera.stop()
    camera.lost = 0
    camera.start()
    numbers = [image.id for image in following(camera, 30) if image.id is not None]
    assert camera.lost == numbers[-1] - numbers[0] + 1 - len(numbers) > 2, (camera.lost, numbers)
    code = "from optolever.camera.cameras import open_camera; open_camera('gige:127.0.0.1')"
    second = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert "busy, another program controls it" in second.stderr, second.stderr
    return camera


if __name__ == "__main__":
    main()
