"""docs/start_aim.png: the step of `optolever start` that aims, of a simulated rig, by headless Chromium.

python docs/start_figure.py [FOLDER: there every step's page, 390 and 1300 pixels wide, light and dark]
"""

import sys
import tempfile
import threading
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests" / "cli"))
from chromium import Chromium

from optolever.cli.rig.start import walk
from optolever.cli.rig.start_page import Interviewer
from optolever.cli.rig.start_steps import STEPS, Begun

OUT = Path(__file__).with_name("start_aim.png")
ANSWERS = {"monitor": {"image": "480x360", "display": "640x480", "diagonal": "15.75", "view_width": "180"}}
ANSWERS["monitor"]["distance"] = "500"
ANSWERS["prism"] = ANSWERS["monitor"] | {
    "display": "480x640",
    "diagonal": "5.5",
    "view_width": "205",
    "distance": "120",
}


def photographed(page: Chromium, folder: Path, name: str) -> None:
    """The page at both widths, light and dark."""
    for width in (390, 1300):
        for dark in (False, True):
            page.look(width, dark)
            time.sleep(0.3)
            page.picture(folder / f"{name}-{width}{'-dark' if dark else ''}.png")


def walked(kind: str, folder: Path | None) -> None:
    """The walk of a simulated rig of that kind by its defaults, up to the live view."""
    with tempfile.TemporaryDirectory() as place:
        begun = Begun.load(Path(place) / "rig.toml")
        begun.write({"devices": {"camera": "virtual"}}, kind=kind, **ANSWERS[kind])
        titles = {name: title for name, (title, _) in STEPS.items()}
        with (
            Interviewer(titles, 0, "optolever start") as front,
            Chromium(Path(place) / "c") as page,
        ):
            thread = threading.Thread(target=walk, args=(begun, front, None), daemon=True)
            thread.start()
            page.open(front.address)
            count = 0
            while thread.is_alive():
                time.sleep(0.2)
                if not page.value("!!document.querySelector('#form button:not(:disabled)')"):
                    continue
                step = page.value("document.querySelector('[aria-current]').textContent")
                names = {title: name for name, title in titles.items()}
                if step == titles["aim"]:
                    page.wait("document.getElementById('picture').naturalWidth")
                    if kind == "monitor":
                        page.look(820, dark=False)
                        time.sleep(0.5)
                        page.picture(OUT)
                if folder is not None:
                    count += 1
                    photographed(page, folder, f"{kind}-{count:02}-{names[step]}")
                page.value("document.querySelector('#form button.first').click()")
                page.wait("!document.querySelector('#form button:not(:disabled)')")


def main() -> None:
    folder = Path(sys.argv[1]) if sys.argv[1:] else None
    if folder is not None:
        folder.mkdir(parents=True, exist_ok=True)
    for kind in ANSWERS if folder is not None else ("monitor",):
        walked(kind, folder)


if __name__ == "__main__":
    main()
