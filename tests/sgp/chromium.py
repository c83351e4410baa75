"""A headless Chromium, driven through the DevTools protocol over a pair of pipes."""

from __future__ import annotations

import base64
import json
import os
import select
import shutil
import subprocess
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

PROGRAM = next(
    (
        path
        for name in ("chromium", "chromium-headless-shell", "chrome")
        if (path := shutil.which(name))
    ),
    None,
)
MISSING = "there is no Chromium: install Debian's package `chromium`"
# Of most tests: the smaller it is, the less a software renderer has to draw.
WINDOW = (960, 640)
_LIMIT_S = 120.0


class BrowserError(Exception):
    """The browser reported an error, or did not answer in time."""


class Browser:
    """One page of a headless Chromium; requests, console messages and exceptions are kept.

    Parameters
    ----------
    profile
        Empty folder for the profile.
    flags
        More arguments.
    size
        Width and height of the window in px.
    """

    def __init__(self, profile: Path, *flags: str, size: tuple[int, int] = WINDOW) -> None:
        self._count, self._buffer = 0, b""
        self.requests: list[str] = []
        self.messages: list[str] = []
        commands, self._write = os.pipe()
        self._read, answers = os.pipe()
        held = []  # the child's ends become its descriptors 3 and 4
        while not held or held[-1] < 5:
            held.append(os.open(os.devnull, os.O_RDONLY))
        for fd in (commands, answers):
            os.set_inheritable(fd, True)
        first, second = os.dup(commands), os.dup(answers)
        self._process = subprocess.Popen(
            [
                str(PROGRAM),
                "--headless=new",
                "--no-sandbox",
                "--disable-gpu-sandbox",
                "--remote-debugging-pipe",
                f"--user-data-dir={profile}",
                f"--window-size={size[0]},{size[1]}",
                "--no-first-run",
                "--disable-background-networking",
                "--disable-component-update",
                "--disable-sync",
                "--disable-dev-shm-usage",
                "--force-device-scale-factor=1",
                "--hide-scrollbars",
                "--force-color-profile=srgb",
                *flags,
                "about:blank",
            ],
            preexec_fn=lambda: (os.dup2(first, 3), os.dup2(second, 4)),
            pass_fds=(3, 4),
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            start_new_session=True,
        )
        for fd in (*held, first, second, commands, answers):
            os.close(fd)
        self._session: str | None = None
        targets = self.call("Target.getTargets")["targetInfos"]
        target = next(one["targetId"] for one in targets if one["type"] == "page")
        attached = self.call("Target.attachToTarget", targetId=target, flatten=True)
        self._session = attached["sessionId"]
        for domain in ("Page", "Runtime", "Log", "Network"):
            self.call(f"{domain}.enable")
        self.resize(*size)

    def close(self) -> None:
        """End the browser."""
        if self._process.poll() is None:
            self._session = None
            try:
                self.call("Browser.close")
            except (BrowserError, OSError):
                self._process.kill()
        self._process.wait(60)
        for fd in (self._read, self._write):
            os.close(fd)

    def call(self, method: str, **parameters: Any) -> Any:
        """Call a method of the protocol and return its result."""
        self._count += 1
        message: dict[str, Any] = {"id": self._count, "method": method, "params": parameters}
        if self._session is not None:
            message["sessionId"] = self._session
        os.write(self._write, json.dumps(message).encode() + b"\0")
        until = time.monotonic() + _LIMIT_S
        while True:
            answer = self._next(until)
            if answer.get("id") == self._count:
                if "error" in answer:
                    raise BrowserError(f"{method}: {answer['error']}")
                return answer["result"]
            self._note(answer)

    def _next(self, until: float) -> dict[str, Any]:
        while b"\0" not in self._buffer:
            ready, _, _ = select.select([self._read], [], [], max(0.0, until - time.monotonic()))
            data = os.read(self._read, 1 << 20) if ready else b""
            if not data:
                raise BrowserError("the browser does not answer")
            self._buffer += data
        line, _, self._buffer = self._buffer.partition(b"\0")
        found: dict[str, Any] = json.loads(line)
        return found

    def _note(self, event: dict[str, Any]) -> None:
        method, content = event.get("method"), event.get("params", {})
        if method == "Network.requestWillBeSent":
            self.requests.append(content["request"]["url"])
        elif method == "Runtime.exceptionThrown":
            details = content["exceptionDetails"]
            self.messages.append(details.get("exception", {}).get("description") or details["text"])
        elif method == "Runtime.consoleAPICalled" and content["type"] in (
            "error",
            "warning",
            "assert",
        ):
            self.messages.append(" ".join(str(one.get("value", one)) for one in content["args"]))
        elif method == "Log.entryAdded" and content["entry"]["level"] in ("error", "warning"):
            self.messages.append(content["entry"]["text"])

    def open(self, path: Path, fragment: str = "") -> None:
        """Open a file and wait until it is loaded."""
        self.visit(path.resolve().as_uri() + fragment)

    def visit(self, address: str) -> None:
        """Open a page and wait until it is loaded."""
        # Without this, another fragment of the open page would not load it again.
        self.call("Page.navigate", url="about:blank")
        self.requests.clear()
        self.messages.clear()
        self.call("Page.navigate", url=address)
        self.until("document.readyState === 'complete' && location.href !== 'about:blank'")

    def value(self, expression: str) -> Any:
        """Return the value of a JavaScript expression, awaited if it is a promise."""
        found = self.call(
            "Runtime.evaluate", expression=expression, returnByValue=True, awaitPromise=True
        )
        if "exceptionDetails" in found:
            raise BrowserError(f"{expression}: {found['exceptionDetails']}")
        return found["result"].get("value")

    def until(self, expression: str, limit_s: float = 120.0) -> None:
        """Wait until an expression is true."""
        until = time.monotonic() + limit_s
        while not self.value(expression):
            if time.monotonic() > until:
                raise BrowserError(f"{expression} did not become true; console: {self.messages}")
            time.sleep(0.05)

    def resize(self, width: int, height: int, *, mobile: bool = False, dark: bool = False) -> None:
        """Change the size of the window in px, and the colours that the page prefers."""
        self.call(
            "Emulation.setDeviceMetricsOverride",
            width=width,
            height=height,
            deviceScaleFactor=1,
            mobile=mobile,
        )
        scheme = {"name": "prefers-color-scheme", "value": "dark" if dark else "light"}
        self.call("Emulation.setEmulatedMedia", features=[scheme])

    def screenshot(self, path: Path, *, whole: bool = False) -> None:
        """Write what the window shows, or the whole page, as a PNG."""
        shot = self.call("Page.captureScreenshot", format="png", captureBeyondViewport=whole)
        path.write_bytes(base64.b64decode(shot["data"]))

    def press(self, key: str, *, shift: bool = False) -> None:
        """Press and release a key, such as ``Tab`` or ``ArrowLeft``."""
        codes = {
            "Tab": 9,
            "Enter": 13,
            " ": 32,
            "ArrowLeft": 37,
            "ArrowUp": 38,
            "ArrowRight": 39,
            "ArrowDown": 40,
        }
        text = {"Enter": "\r", " ": " "}.get(key, key if len(key) == 1 else "")
        held = 8 if shift else 0
        shared = {
            "key": key,
            "code": key,
            "windowsVirtualKeyCode": codes.get(key, ord(key[0])),
            "modifiers": held,
        }
        self.call(
            "Input.dispatchKeyEvent", type="keyDown" if text else "rawKeyDown", text=text, **shared
        )
        self.call("Input.dispatchKeyEvent", type="keyUp", **shared)

    def touch(self, *paths: Sequence[tuple[float, float]]) -> None:
        """Move fingers along paths of equal length in the window, and lift them."""
        for number, places in enumerate(zip(*paths, strict=True)):
            points = [{"x": x, "y": y, "id": finger} for finger, (x, y) in enumerate(places)]
            kind = "touchMove" if number else "touchStart"
            self.call("Input.dispatchTouchEvent", type=kind, touchPoints=points)
        self.call("Input.dispatchTouchEvent", type="touchEnd", touchPoints=[])

    def drag(self, start: tuple[float, float], end: tuple[float, float], steps: int = 4) -> None:
        """Drag with the left button between two places of the window."""

        def send(kind: str, share: float, buttons: int) -> None:
            x, y = (a + share * (b - a) for a, b in zip(start, end, strict=True))
            self.call(
                "Input.dispatchMouseEvent",
                type=kind,
                x=x,
                y=y,
                button="left",
                buttons=buttons,
                clickCount=1,
            )

        send("mousePressed", 0, 1)
        for step in range(1, steps + 1):
            send("mouseMoved", step / steps, 1)
        send("mouseReleased", 1, 0)
