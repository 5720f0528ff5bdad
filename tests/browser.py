"""A real browser, headless, spoken to over its own pipe: pages are opened, measured, looked at and photographed."""

from __future__ import annotations

import base64
import json
import os
import select
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
PATIENCE = 60.0     # seconds for one answer; the machine may be busy
# Chromium reads commands from descriptor 3 and answers on 4.
PIPED = """import os, sys
ask, answer = (os.dup(int(one)) for one in sys.argv[1:3])
while min(ask, answer) < 5:
    ask, answer = os.dup(ask), os.dup(answer)
os.dup2(ask, 3)
os.dup2(answer, 4)
os.execv(sys.argv[3], sys.argv[3:])
"""


def found() -> str | None:
    """The path of a browser of this machine, None where there is none."""
    return next((path for path in map(shutil.which, NAMES) if path), None)


class Browser:
    """One headless Chromium with one page; `said` collects what its console said and which requests it made."""

    def __init__(self, program: str, folder: str) -> None:
        theirs, self._ask = os.pipe()
        self._hear, answers = os.pipe()
        # A sandbox cannot be had as root.
        words = [program, "--headless", "--no-sandbox", "--disable-gpu", "--hide-scrollbars", "--no-first-run",
                 f"--user-data-dir={folder}", "--disable-dev-shm-usage", "--remote-debugging-pipe"]
        self._child = subprocess.Popen([sys.executable, "-c", PIPED, str(theirs), str(answers), *words],
                                       pass_fds=(theirs, answers), stdin=subprocess.DEVNULL,
                                       stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        os.close(theirs)
        os.close(answers)
        self._number, self._session, self._rest = 0, "", b""
        self.said: list[str] = []
        self.requests: list[str] = []
        self._loaded = False
        try:
            self._begin()
        except Exception:
            self.close()
            raise

    def _begin(self) -> None:
        target = self.tell("Target.createTarget", url="about:blank")["targetId"]
        self._session = self.tell("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
        for domain in ("Page", "Runtime", "Log", "Network"):
            self.tell(f"{domain}.enable")

    def close(self) -> None:
        with suppress(OSError, RuntimeError):
            self.tell("Browser.close")
        os.close(self._ask)
        try:
            self._child.wait(10)
        except subprocess.TimeoutExpired:
            self._child.kill()
            self._child.wait()
        os.close(self._hear)

    def tell(self, method: str, **parameters: Any) -> dict[str, Any]:
        """Give one command of the DevTools protocol and wait for its answer."""
        self._number += 1
        message = {"id": self._number, "method": method, "params": parameters}
        if self._session:
            message["sessionId"] = self._session
        os.write(self._ask, json.dumps(message).encode() + b"\0")
        while True:
            heard = self._next()
            if heard.get("id") == self._number:
                if "error" in heard:
                    raise RuntimeError(f"{method}: {heard['error']}")
                return heard.get("result", {})

    def _next(self) -> dict[str, Any]:
        until = time.monotonic() + PATIENCE
        while b"\0" not in self._rest:
            ready, _, _ = select.select([self._hear], [], [], max(0.0, until - time.monotonic()))
            piece = os.read(self._hear, 1 << 20) if ready else b""
            if not piece:
                raise RuntimeError("the browser does not answer")
            self._rest += piece
        text, _, self._rest = self._rest.partition(b"\0")
        heard = json.loads(text)
        self._note(heard.get("method", ""), heard.get("params", {}))
        return heard

    def _note(self, method: str, event: dict[str, Any]) -> None:
        if method == "Runtime.consoleAPICalled" and event["type"] in ("error", "warning", "assert"):
            self.said.append(" ".join(str(one.get("value", one.get("description"))) for one in event["args"]))
        elif method == "Runtime.exceptionThrown":
            details = event["exceptionDetails"]
            self.said.append(details.get("exception", {}).get("description", details["text"]))
        elif method == "Log.entryAdded" and event["entry"]["level"] in ("error", "warning"):
            self.said.append(event["entry"]["text"])
        elif method == "Network.requestWillBeSent":
            self.requests.append(event["request"]["url"])
        elif method == "Page.loadEventFired":
            self._loaded = True

    def open(self, path: Path, width: int, dark: bool = False, media: str = "screen", script: bool = True) -> None:
        """Open a file in a window of that width, light or dark, on screen or as for print, with or without script."""
        self.said.clear()
        self.requests.clear()
        self.tell("Emulation.setDeviceMetricsOverride", width=width, height=900, deviceScaleFactor=1, mobile=False)
        scheme = {"name": "prefers-color-scheme", "value": "dark" if dark else "light"}
        self.tell("Emulation.setEmulatedMedia", media=media, features=[scheme])
        self.tell("Emulation.setScriptExecutionDisabled", value=not script)
        self._loaded = False
        self.tell("Page.navigate", url=path.resolve().as_uri())
        while not self._loaded:
            self._next()

    def evaluate(self, expression: str) -> Any:
        """The value of a JavaScript expression on the page."""
        answer = self.tell("Runtime.evaluate", expression=expression, returnByValue=True, awaitPromise=True)
        if "exceptionDetails" in answer:
            raise RuntimeError(f"{expression}: {answer['exceptionDetails']}")
        return answer["result"].get("value")

    def press(self, key: str) -> None:
        """Press and let go a key such as ArrowLeft or Tab."""
        for what in ("rawKeyDown", "keyUp"):
            self.tell("Input.dispatchKeyEvent", type=what, key=key, code=key)

    def photograph(self, path: Path, whole: bool = True) -> Path:
        """A PNG of the page, the whole of it or what the window shows."""
        shot = self.tell("Page.captureScreenshot", format="png", captureBeyondViewport=whole)
        path.write_bytes(base64.b64decode(shot["data"]))
        return path

    def printed(self) -> bytes:
        """The page as PDF, as a printer gets it."""
        return base64.b64decode(self.tell("Page.printToPDF", printBackground=False)["data"])


@contextmanager
def browsing() -> Iterator[Browser]:
    """A browser for as long as the block lasts; only where `found` finds one."""
    program = found()
    assert program is not None
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
        browser = Browser(program, folder)
        try:
            yield browser
        finally:
            browser.close()
