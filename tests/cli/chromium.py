"""Requests of a page, and headless Chromium by its debugging pipe: open, evaluate, wait, picture."""

import base64
import contextlib
import http.client
import json
import os
import re
import shutil
import subprocess
import time
from pathlib import Path
from typing import Any, Self

import pytest

FLAGS = ["--headless=new", "--no-sandbox", "--disable-gpu", "--no-first-run", "--hide-scrollbars"]
FLAGS += ["--disable-background-networking", "--disable-component-update", "--disable-sync"]
MESSAGES = "Runtime.exceptionThrown", "Log.entryAdded", "Runtime.consoleAPICalled"


def chromium() -> str:
    """Its path; skips the test where there is none."""
    path = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
    return path or pytest.skip("no Chromium on this machine (apt-get install chromium)")


def printed(address: str, folder: Path, *options: str) -> str:
    """What it prints of a page with more options; with --enable-logging=stderr no message is allowed."""
    command = [chromium(), *FLAGS, f"--user-data-dir={folder}", *options, address]
    done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=120)
    assert "CONSOLE" not in done.stderr, done.stderr
    return done.stdout


def answered(address: str, text: str) -> tuple[int, str]:
    """Status and words for an answer to a form of the page of `start`."""
    token = re.findall(r'"([A-Za-z0-9_-]{43})"', asked(address, "/")[1].decode())[0]
    status, words = asked(address, "/answer", "POST", text, **{"X-Optolever-Token": token})
    return status, words.decode()


def asked(
    address: str, path: str, method: str = "GET", body: str | None = None, **headers: str
) -> tuple[int, bytes]:
    """Status and body of the answer of a page's server."""
    host = address.removeprefix("http://").rstrip("/")
    connection = http.client.HTTPConnection(host, timeout=30)
    connection.request(method, path, body, headers={"Host": host, **headers})
    with contextlib.closing(connection), connection.getresponse() as answer:
        return answer.status, answer.read()


class Chromium:
    """One page. messages: what it wrote to its console, and its errors."""

    def __init__(self, folder: Path) -> None:
        ours, theirs = os.pipe(), os.pipe()
        command = f'exec "$@" 3<&{ours[0]} 4>&{theirs[1]}'
        words = [chromium(), *FLAGS, "--remote-debugging-pipe", f"--user-data-dir={folder}", "about:blank"]
        self._process = subprocess.Popen(
            ["bash", "-c", command, "chromium", *words],
            pass_fds=(ours[0], theirs[1]), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
        )  # fmt: skip
        os.close(ours[0])
        os.close(theirs[1])
        self._to, self._from = os.fdopen(ours[1], "wb", 0), os.fdopen(theirs[0], "rb", 0)
        self._number, self._rest, self._session = 0, b"", ""
        self.messages: list[str] = []
        target = self.call("Target.createTarget", url="about:blank")["targetId"]
        self._session = self.call("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
        for domain in ("Page", "Runtime", "Log"):
            self.call(f"{domain}.enable")

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._process.kill()
        self._process.wait()
        self._to.close()
        self._from.close()

    def call(self, method: str, **params: Any) -> dict[str, Any]:
        """The result of a command of the protocol."""
        self._number += 1
        message = {"id": self._number, "method": method, "params": params}
        message |= {"sessionId": self._session} if self._session else {}
        self._to.write(json.dumps(message).encode() + b"\0")
        while True:
            while b"\0" not in self._rest:
                part = self._from.read(1 << 16)
                assert part, "Chromium has ended"
                self._rest += part
            text, _, self._rest = self._rest.partition(b"\0")
            answer = json.loads(text)
            if answer.get("method") in MESSAGES:
                self.messages.append(text.decode())
            if answer.get("id") == self._number:
                assert "result" in answer, answer
                return dict(answer["result"])

    def open(self, address: str) -> None:
        """Go to a page."""
        self.call("Page.navigate", url=address)

    def value(self, script: str) -> Any:
        """Of an expression."""
        found = self.call("Runtime.evaluate", expression=script, returnByValue=True)
        assert "exceptionDetails" not in found, found
        return found["result"].get("value")

    def wait(self, script: str, seconds: float = 300.0) -> Any:
        """Until an expression holds."""
        end = time.monotonic() + seconds
        while not (found := self.value(f"!!({script})")):
            assert time.monotonic() < end, f"{script}: {self.value('document.body.innerText')}"
            time.sleep(0.1)
        return found

    def look(self, width: int, dark: bool) -> None:
        """The size of the window, and whether it is dark."""
        self.call(
            "Emulation.setDeviceMetricsOverride", width=width, height=900, deviceScaleFactor=1, mobile=False
        )
        scheme = {"name": "prefers-color-scheme", "value": "dark" if dark else "light"}
        self.call("Emulation.setEmulatedMedia", features=[scheme])

    def picture(self, file: Path) -> None:
        """The page as PNG."""
        data = self.call("Page.captureScreenshot", format="png", captureBeyondViewport=True)["data"]
        file.write_bytes(base64.b64decode(data))
