"""Shows frames in a window and writes what the X server's screen holds; run by test_window.py.

Arguments: folder of the server's frame buffer file, output .npz, 'window' or 'full-screen'; or 'keys'.
"""

import sys
import threading
from pathlib import Path

import glfw
import numpy as np
from screen import FrameBuffer

from optolever.patterns import sequence
from optolever.projector import PatternWindow, monitors
from optolever.projector.window import Window


def press_keys() -> None:
    """Print the frame on show after right, right, left and Escape, pressed before `run`, from frame 2 on."""
    window = Window(sequence("gray+phase", 48, 80))
    window.show(2)
    for key in (glfw.KEY_RIGHT, glfw.KEY_RIGHT, glfw.KEY_LEFT):
        window._on_key(window._window, key, 0, glfw.PRESS, 0)
        window._on_key(window._window, key, 0, glfw.RELEASE, 0)
    threading.Timer(0.3, lambda: window._on_key(window._window, glfw.KEY_ESCAPE, 0, glfw.PRESS, 0)).start()
    window.run()
    print(window.index)


def main(folder: Path, out: Path, mode: str) -> None:
    """Show three frames, keep the screen's pixels of each."""
    found = monitors()
    screen = FrameBuffer(folder, found[0].rows, found[0].cols)
    shown = sequence("gray+phase", 48, 80)
    screens = []
    monitor = 0 if mode == "full-screen" else None
    with PatternWindow(shown, monitor=monitor) as window:
        for index in range(3):
            window.show(index)
            screens.append(screen.pixels.copy())
    sizes = [(monitor.rows, monitor.cols) for monitor in found]
    np.savez(out, screens=screens, monitors=sizes, expected=shown.render()[:3])


if __name__ == "__main__":
    if sys.argv[1:] == ["keys"]:
        press_keys()
    else:
        main(Path(sys.argv[1]), Path(sys.argv[2]), sys.argv[3])
