# Copyright 2026 the gtmr authors
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except
# in compliance with the License. You may obtain a copy of the License at
# http://www.apache.org/licenses/LICENSE-2.0 Unless required by applicable law or agreed to in
# writing, software distributed under the License is distributed on an "AS IS" BASIS, WITHOUT
# WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific
# language governing permissions and limitations under the License.

"""Headless Chromium by its DevTools protocol: what a page draws, asks for and complains of."""

from __future__ import annotations

import base64
import itertools
import json
import shutil
import subprocess
import tempfile
import time
import urllib.request
from collections.abc import Callable
from pathlib import Path
from typing import Any

from websockets.sync.client import connect

NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
DEADLINE_S = 60.0
WCAG_AA = ("wcag2a", "wcag2aa", "wcag21a", "wcag21aa")
OPTIONS = (
    "--headless",
    "--no-sandbox",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-dev-shm-usage",
    "--disable-sync",
    # WebGL in software, since a machine for tests has no graphics card; the rest of the page
    # by the plain compositor, which is much faster than that on top of software WebGL.
    "--disable-gpu",
    "--enable-unsafe-swiftshader",
    # Nothing but this machine exists, so a page that needs the network cannot pass unnoticed.
    "--host-resolver-rules=MAP * ~NOTFOUND, EXCLUDE 127.0.0.1",
    "--remote-debugging-port=0",
)


def find() -> str | None:
    """Path of a Chromium, if there is one."""
    return next(filter(None, map(shutil.which, NAMES)), None)


class Page:
    """A page in a browser of its own; use it as a context manager."""

    def __init__(self, url: str, width: int = 1280, height: int = 800) -> None:
        self.requests: list[str] = []
        self.complaints: list[str] = []
        self._numbers = itertools.count(1)
        self._size = width, height
        self._url = url

    def __enter__(self) -> Page:
        executable = find()
        assert executable is not None, "no Chromium"
        self._profile = tempfile.TemporaryDirectory(ignore_cleanup_errors=True)
        width, height = self._size
        self._process = subprocess.Popen(
            [
                executable,
                *OPTIONS,
                f"--window-size={width},{height}",
                f"--user-data-dir={self._profile.name}",
                "about:blank",
            ],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        try:
            self._socket = connect(self._address(), max_size=None, compression=None)
            for domain in ("Page", "Network", "Runtime", "Log"):
                self.call(f"{domain}.enable")
            self.call("Page.navigate", url=self._url)
        except BaseException:
            self._end()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        self._socket.close()
        self._end()

    def _end(self) -> None:
        self._process.terminate()
        try:
            self._process.wait(10.0)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._profile.cleanup()

    def _address(self) -> str:
        """WebSocket of the first tab, once the browser listens."""
        port_file = Path(self._profile.name) / "DevToolsActivePort"
        end = time.monotonic() + DEADLINE_S
        while time.monotonic() < end:
            if port_file.exists() and (text := port_file.read_text()):
                url = f"http://127.0.0.1:{text.split()[0]}/json/list"
                with urllib.request.urlopen(url, timeout=DEADLINE_S) as answer:
                    tabs = [tab for tab in json.load(answer) if tab["type"] == "page"]
                if tabs:
                    return str(tabs[0]["webSocketDebuggerUrl"])
            time.sleep(0.05)
        raise TimeoutError(f"Chromium was not up within {DEADLINE_S} s")

    def call(self, method: str, **parameters: Any) -> dict[str, Any]:
        """Call a method of the protocol; what the page does meanwhile is noted."""
        number = next(self._numbers)
        self._socket.send(json.dumps({"id": number, "method": method, "params": parameters}))
        while True:
            message = json.loads(self._socket.recv(timeout=DEADLINE_S))
            if message.get("id") == number:
                assert "error" not in message, f"{method}: {message['error']}"
                return dict(message["result"])
            self._note(message["method"], message["params"])

    def _note(self, event: str, parameters: dict[str, Any]) -> None:
        if event == "Network.requestWillBeSent":
            self.requests.append(parameters["request"]["url"])
        elif event == "Network.webSocketCreated":
            self.requests.append(parameters["url"])
        elif event == "Runtime.exceptionThrown":
            self.complaints.append(str(parameters["exceptionDetails"]))
        elif event == "Runtime.consoleAPICalled" and parameters["type"] in ("error", "assert"):
            said = (str(each.get("value", each)) for each in parameters["args"])
            self.complaints.append(" ".join(said))
        elif event == "Log.entryAdded" and parameters["entry"]["level"] == "error":
            self.complaints.append(f"{parameters['entry']['text']} {parameters['entry']}")

    def evaluate(self, expression: str) -> Any:
        """Value of a JavaScript expression."""
        result = self.call("Runtime.evaluate", expression=expression, returnByValue=True)
        return result["result"].get("value")

    def wait_until(self, condition: Callable[[], bool], deadline_s: float = DEADLINE_S) -> None:
        """Wait for something to become so."""
        end = time.monotonic() + deadline_s
        while not condition():
            if time.monotonic() > end:
                raise TimeoutError(f"not so within {deadline_s} s; said: {self.complaints}")
            time.sleep(0.1)

    def screenshot(self) -> bytes:
        """What can be seen, as PNG."""
        return base64.b64decode(self.call("Page.captureScreenshot", format="png")["data"])

    def resize(self, width: int, height: int) -> None:
        """Give the page another size, as on another screen [CSS pixels]."""
        self.call(
            "Emulation.setDeviceMetricsOverride",
            width=width, height=height, deviceScaleFactor=1, mobile=False,
        )  # fmt: skip

    def prefer(self, scheme: str) -> None:
        """Wish for the theme ``light`` or ``dark``, as the browser's settings do."""
        features = [{"name": "prefers-color-scheme", "value": scheme}]
        self.call("Emulation.setEmulatedMedia", features=features)

    def overflow_px(self) -> int:
        """By how many CSS pixels the page is wider than its window."""
        root = "document.documentElement"
        return int(self.evaluate(f"{root}.scrollWidth - {root}.clientWidth"))

    def inaccessible(self, axe: str, *rules: str) -> list[str]:
        """Say what axe-core (its source) finds by WCAG 2.1 A and AA, or by some rules."""
        self.call("Runtime.evaluate", expression=axe)
        only = {"type": "rule", "values": rules} if rules else {"type": "tag", "values": WCAG_AA}
        answer = self.call(
            "Runtime.evaluate",
            expression=f"axe.run(document, {{runOnly: {json.dumps(only)}}})"
            ".then(({violations}) => violations.flatMap(({id, nodes}) => "
            "nodes.map((node) => `${id}: ${node.html} ${node.failureSummary}`)))",
            awaitPromise=True,
            returnByValue=True,
        )
        assert "exceptionDetails" not in answer, answer
        return list(answer["result"]["value"])
