"""A page in headless Chromium, over the DevTools protocol: what it fetched, and what it looks like."""

import base64
import json
import os
import select
import shutil
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import cv2
import numpy as np


def _found() -> str | None:
    """Return the browser, if there is one that can be started."""
    path = shutil.which("chromium")
    works = path is not None and subprocess.run([path, "--version"], capture_output=True, check=False).returncode == 0
    return path if works else None


CHROMIUM = _found()
_SWITCHES = (
    "--headless=new",
    "--no-sandbox",  # root of a container has none
    "--disable-dev-shm-usage",
    "--disable-background-networking",
    "--no-first-run",
    "--hide-scrollbars",
    # Rerun draws by WebGPU or WebGL; without a graphics card by software.
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--ignore-gpu-blocklist",
)


class Page:
    """A page that is open. fetched: all bytes that scripts of the page fetched, whether the fetch has ended or not."""

    def __init__(self, to_browser: int, from_browser: int, address: str) -> None:
        self._to, self._from, self._rest = to_browser, from_browser, b""
        self._calls, self._answers = 0, {}
        self._session: str | None = None
        self.fetched = bytearray()
        target = self._call("Target.createTarget", url="about:blank")["targetId"]
        self._session = self._call("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
        self._call("Network.enable")
        self._call("Page.enable")
        self._loaded = False
        self._call("Page.navigate", url=address)
        while not self._loaded:
            self._take(60.0, wanted=True)

    def watch(self, seconds: float) -> None:
        """Let the page live for a while, and take in what it fetches."""
        end = time.monotonic() + seconds
        while (left_s := end - time.monotonic()) > 0:
            self._take(left_s)

    def screenshot(self) -> np.ndarray:
        """Return what the page looks like (H, W, 3), BGR."""
        data = base64.b64decode(self._call("Page.captureScreenshot")["data"])
        return cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)

    def _call(self, method: str, **params: object) -> dict[str, Any]:
        number = self._send(method, **params)
        while number not in self._answers:
            self._take(60.0, wanted=True)
        answer = self._answers.pop(number)
        assert "error" not in answer, answer
        return answer["result"]

    def _send(self, method: str, **params: object) -> int:
        self._calls += 1
        message = {"id": self._calls, "method": method, "params": params}
        message |= {"sessionId": self._session} if self._session else {}
        os.write(self._to, json.dumps(message).encode() + b"\0")
        return self._calls

    def _take(self, wait_s: float, *, wanted: bool = False) -> None:
        ready, _, _ = select.select([self._from], [], [], wait_s)
        assert ready or not wanted, "the browser does not answer"
        if not ready:
            return
        content = os.read(self._from, 1 << 20)
        assert content, "the browser has ended"
        *messages, self._rest = (self._rest + content).split(b"\0")
        for text in messages:
            message = json.loads(text)
            if "id" in message:
                self._answers[message["id"]] = message
                self.fetched += base64.b64decode(message.get("result", {}).get("bufferedData", ""))
            elif message["method"] == "Network.responseReceived" and message["params"]["type"] == "Fetch":
                self._send("Network.streamResourceContent", requestId=message["params"]["requestId"])
            elif message["method"] == "Network.dataReceived":
                self.fetched += base64.b64decode(message["params"].get("data", ""))
            elif message["method"] == "Page.loadEventFired":
                self._loaded = True


@contextmanager
def page(address: str, profile: Path, size: tuple[int, int] = (800, 600)) -> Iterator[Page]:
    """Open a page in a browser of its own, whose files are in the folder `profile`."""
    assert CHROMIUM is not None
    (theirs_in, ours_out), (ours_in, theirs_out) = os.pipe(), os.pipe()
    command = [CHROMIUM, *_SWITCHES, f"--window-size={size[0]},{size[1]}", f"--user-data-dir={profile}"]
    # The protocol is spoken on descriptors 3 and 4.
    shell = ["bash", "-c", f'exec "$@" 3<&{theirs_in} 4>&{theirs_out}', "bash", *command, "--remote-debugging-pipe"]
    browser = subprocess.Popen(
        shell, pass_fds=(theirs_in, theirs_out), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    )
    os.close(theirs_in)
    os.close(theirs_out)
    try:
        yield Page(ours_out, ours_in, address)
    finally:
        browser.kill()
        browser.wait()
        os.close(ours_out)
        os.close(ours_in)
