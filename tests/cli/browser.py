"""A headless Chromium that is driven by the DevTools protocol over a pipe."""

import base64
import fcntl
import json
import os
import select
import shutil
import subprocess
import time
from pathlib import Path
from typing import Any

PROGRAM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("chrome")
_FLAGS = ("--headless=new", "--no-sandbox", "--disable-gpu", "--remote-debugging-pipe")


class Page:
    """A page in a browser of its own; `events` holds everything that the browser reports.

    Use it in a `with` statement, which ends the browser.
    """

    def __init__(self, profile: Path, width: int = 1100) -> None:
        assert PROGRAM is not None
        there, commands = os.pipe()
        events, here = os.pipe()
        # Chromium reads from descriptor 3 and writes to 4; copies above 9 cannot be overwritten.
        ends = [fcntl.fcntl(end, fcntl.F_DUPFD, 10) for end in (there, here)]
        flags = (*_FLAGS, f"--user-data-dir={profile}", f"--window-size={width},900")
        shell = f'exec "$@" 3<&{ends[0]} 4>&{ends[1]}'
        self._process = subprocess.Popen(
            ["bash", "-c", shell, "bash", PROGRAM, *flags, "about:blank"],
            pass_fds=ends,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        for end in (there, here, *ends):
            os.close(end)
        self._commands, self._replies, self._buffer, self._number = commands, events, b"", 0
        self.events: list[dict[str, Any]] = []
        self._session: dict[str, str] = {}
        target = self("Target.createTarget", url="about:blank")["targetId"]
        attached = self("Target.attachToTarget", targetId=target, flatten=True)
        self._session = {"sessionId": attached["sessionId"]}
        for domain in ("Page", "Runtime", "Log", "Network"):
            self(f"{domain}.enable")

    def __enter__(self) -> "Page":
        return self

    def __exit__(self, *_: object) -> None:
        self._process.kill()
        self._process.wait()
        os.close(self._commands)
        os.close(self._replies)

    def __call__(self, method: str, **parameters: Any) -> dict[str, Any]:
        """Send a command and return its result; the events before it are kept."""
        self._number += 1
        message = {"id": self._number, "method": method, "params": parameters, **self._session}
        os.write(self._commands, json.dumps(message).encode() + b"\0")
        while (reply := self._next(30.0)).get("id") != self._number:
            self.events.append(reply)
        if "error" in reply:
            raise RuntimeError(f"{method}: {reply['error']}")
        return reply["result"]

    def _next(self, patience_s: float) -> dict[str, Any]:
        while b"\0" not in self._buffer:
            if not select.select([self._replies], [], [], patience_s)[0]:
                raise TimeoutError(f"Chromium said nothing for {patience_s:g} s.")
            if not (read := os.read(self._replies, 1 << 20)):
                raise EOFError("Chromium has ended.")
            self._buffer += read
        message, _, self._buffer = self._buffer.partition(b"\0")
        return json.loads(message)

    def run(self, script: str) -> Any:
        """Return the value of a JavaScript expression."""
        found = self("Runtime.evaluate", expression=script, returnByValue=True, awaitPromise=True)
        if "exceptionDetails" in found:
            raise RuntimeError(found["exceptionDetails"])
        return found["result"].get("value")

    def open(self, path: Path, ready: str = "true", patience_s: float = 20.0) -> None:
        """Open a file and wait until the expression `ready` is true."""
        self("Page.navigate", url=path.as_uri())
        ends = time.monotonic() + patience_s
        while not (self.run("document.readyState") == "complete" and self.run(ready)):
            if time.monotonic() > ends:
                raise TimeoutError(f"{ready} is not true.")
            time.sleep(0.05)

    def emulate(self, width: int, scheme: str = "light", media: str = "") -> None:
        """Set the width, the colour scheme and the medium."""
        size = {"width": width, "height": 900, "deviceScaleFactor": 1, "mobile": width < 600}
        self("Emulation.setDeviceMetricsOverride", **size)
        feature = {"name": "prefers-color-scheme", "value": scheme}
        self("Emulation.setEmulatedMedia", media=media, features=[feature])

    def picture(self) -> bytes:
        """Return the whole page as PNG."""
        found = self("Page.captureScreenshot", captureBeyondViewport=True)
        return base64.b64decode(found["data"])

    def pdf(self) -> bytes:
        """Return the page as it is printed."""
        return base64.b64decode(
            self("Page.printToPDF", printBackground=False, preferCSSPageSize=True)["data"]
        )
