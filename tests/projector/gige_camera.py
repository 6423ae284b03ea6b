"""Opens a GigE camera on loopback as the program does and prints a word for every thing that holds.

Run by test_cameras.py in a network of its own; with "host" it is the camera, until stdin ends.
"""

import subprocess
import sys
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent))
from gige_host import GigEHost, Request

from optolever.projector import CameraLost, Image, Wanted
from optolever.projector.cameras import find_cameras, open_camera

ROWS, COLS = 120, 160


def picture(request: Request) -> np.ndarray:
    """A picture that tells its number; every seventh number is left out."""
    number = request.frame_id
    request.frame_id = number + number // 7
    return expected(request.frame_id, request.bits)


def expected(number: int, bits: int) -> np.ndarray:
    rows, cols = np.mgrid[:ROWS, :COLS]
    return (rows * 3 + cols * 5 + number) % 2**bits


def host() -> None:
    with GigEHost(picture) as camera:
        print("ready", flush=True)
        for line in sys.stdin:
            camera.lose(float(line))
            print("ok", flush=True)


def started() -> "subprocess.Popen[str]":
    pipe = subprocess.PIPE
    process = subprocess.Popen([sys.executable, __file__, "host"], stdin=pipe, stdout=pipe, text=True)
    assert process.stdout is not None
    assert process.stdout.readline().strip() == "ready"
    return process


def lose(process: "subprocess.Popen[str]", share: float) -> None:
    assert process.stdin is not None
    assert process.stdout is not None
    process.stdin.write(f"{share}\n")
    process.stdin.flush()
    assert process.stdout.readline().strip() == "ok"


def following(camera: object, count: int) -> list[Image]:
    images: list[Image] = []
    limit = time.monotonic() + 30
    while len(images) < count and time.monotonic() < limit:
        image = camera.next(1.0)  # type: ignore[attr-defined]
        if image is not None:
            images.append(image)
    assert len(images) == count
    return images


def main() -> None:
    process = started()
    try:
        run(process)
    finally:
        process.kill()
        process.wait()


def run(process: "subprocess.Popen[str]") -> None:
    found, _ = find_cameras()
    (one,) = [each for each in found if each.serial == "TEST-1"]
    assert one.address == "gige:127.0.0.1", one
    print("found")
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
    print("exact")
    camera.configure(Wanted(0.005, ROWS, COLS, trigger="software"))
    camera.start()
    for _ in range(3):
        sent = camera.trigger()
        (image,) = following(camera, 1)
        assert image.arrived_s > sent
    assert camera.next(0.3) is None
    camera.stop()
    print("triggered")
    camera.configure(Wanted(0.005, ROWS, COLS, fps=50))
    lose(process, 0.1)
    camera.start()
    broken = [image for image in following(camera, 40) if not image.complete]
    assert broken
    assert all(image.pixels.size == 0 and image.why for image in broken)
    lose(process, 0.0)
    camera.stop()
    print("incomplete")
    camera.lost = 0
    camera.start()
    images = following(camera, 30)
    numbers = [image.id for image in images if image.id is not None]
    assert camera.lost == numbers[-1] - numbers[0] + 1 - len(numbers) > 2, (camera.lost, numbers)
    print("counted")
    code = "from optolever.projector.cameras import open_camera; open_camera('gige:127.0.0.1')"
    second = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert "busy, another program controls it" in second.stderr, second.stderr
    print("busy")
    process.kill()
    process.wait()
    try:
        limit = time.monotonic() + 30
        while time.monotonic() < limit:
            camera.next(0.5)
        raise AssertionError("a dead camera was not noticed in 30 s")
    except CameraLost:
        print("lost")
    camera.close()
    again = started()
    try:
        camera = open_camera("gige:127.0.0.1")
        camera.configure(Wanted(0.005, ROWS, COLS, fps=50))
        camera.start()
        following(camera, 3)
        camera.close()
        print("again")
    finally:
        again.kill()
        again.wait()


if __name__ == "__main__":
    host() if sys.argv[1:] == ["host"] else main()
