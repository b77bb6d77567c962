"""Debian's Firefox on a display, driven through WebDriver BiDi (w3.org/TR/webdriver-bidi).

Without a display (``--headless``) it has no WebGL where there is no graphics card.
"""

import asyncio
import base64
import json
import re
import shutil
import subprocess
import time
from pathlib import Path
from typing import Any, Self

from tornado.websocket import WebSocketClientConnection, websocket_connect

_NAMES = ("firefox-esr", "firefox")
_PATIENCE_S = 120.0
_POLL_S = 0.1
_LARGEST = 1 << 26  # bytes of an answer: a picture in base64
# No question, no update, nothing from the network; WebGL is drawn by the processor.
_PREFERENCES = {
    "webgl.force-enabled": True,
    "app.update.enabled": False,
    "app.normandy.enabled": False,
    "browser.aboutwelcome.enabled": False,
    "browser.shell.checkDefaultBrowser": False,
    "browser.startup.homepage_override.mstone": "ignore",
    "browser.startup.page": 0,
    "datareporting.policy.dataSubmissionEnabled": False,
    "extensions.update.enabled": False,
    "network.captive-portal-service.enabled": False,
    "network.connectivity-service.enabled": False,
    "toolkit.telemetry.reportingpolicy.firstRun": False,
    "ui.prefersReducedMotion": 1,
    "layout.css.prefers-color-scheme.content-override": 0,  # dark
}


def firefox() -> str | None:
    """The program, None where there is none."""
    return next((found for name in _NAMES if (found := shutil.which(name))), None)


async def _connected(address: str) -> WebSocketClientConnection:
    return await websocket_connect(address, max_message_size=_LARGEST)


class Firefox:
    """A browser with one tab on ``display``; leave the context to end it.

    ``folder``: for its profile and its log; ``size``: of the page, pixels.
    """

    def __init__(self, program: str, display: str, folder: Path, size: tuple[int, int]) -> None:
        profile = folder / "profile"
        profile.mkdir()
        lines = [f"user_pref({json.dumps(k)}, {json.dumps(v)});" for k, v in _PREFERENCES.items()]
        (profile / "user.js").write_text("\n".join(lines), encoding="utf-8")
        self._loop = asyncio.new_event_loop()
        self._connection: WebSocketClientConnection | None = None
        self._last = 0  # id of a command
        self._log = folder / "firefox.log"
        with self._log.open("wb") as log:
            self._process = subprocess.Popen(
                [
                    *(program, "--no-remote", "--remote-debugging-port", "0"),
                    *("--profile", str(profile), "about:blank"),
                ],
                stdout=log,
                stderr=log,
                env={
                    **{"HOME": str(folder), "PATH": "/usr/bin:/bin", "DISPLAY": display},
                    **{"LIBGL_ALWAYS_SOFTWARE": "1", "GDK_BACKEND": "x11"},
                },
            )
        self._size = size

    def __enter__(self) -> Self:
        """Wait for the browser and open a tab of the size of the page."""
        try:
            self._connection = self._loop.run_until_complete(
                _connected(f"{self._address()}/session")
            )
            self.ask("session.new", capabilities={})
            self.tab = self.ask("browsingContext.getTree")["contexts"][0]["context"]
            width, height = self._size
            view = {"width": width, "height": height}
            self.ask("browsingContext.setViewport", context=self.tab, viewport=view)
        except BaseException:
            self.__exit__()
            raise
        return self

    def __exit__(self, *error: object) -> None:
        """End the browser."""
        if self._connection is not None:
            self._connection.close()
        self._process.terminate()
        try:
            self._process.wait(10)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._loop.close()

    def _address(self) -> str:
        end = time.monotonic() + _PATIENCE_S
        while time.monotonic() < end:
            said = self._log.read_text(encoding="utf-8", errors="replace")
            if found := re.search(r"WebDriver BiDi listening on (ws://\S+)", said):
                return found[1]
            if self._process.poll() is not None:
                break
            time.sleep(_POLL_S)
        raise RuntimeError(f"Firefox did not start:\n{said[-2000:]}")

    def ask(self, method: str, **parameters: object) -> Any:
        """Send a command and return what it answers; ``RuntimeError`` when it fails."""
        assert self._connection is not None
        self._last += 1
        command = {"id": self._last, "method": method, "params": parameters}
        return self._loop.run_until_complete(self._answer(json.dumps(command)))

    async def _answer(self, command: str) -> Any:
        assert self._connection is not None
        await self._connection.write_message(command)
        while True:
            waiting = self._connection.read_message()
            message = await asyncio.wait_for(asyncio.ensure_future(waiting), _PATIENCE_S)
            if message is None:
                raise RuntimeError("Firefox is gone")
            said = json.loads(message)
            if said.get("id") == self._last:
                if said["type"] == "error":
                    raise RuntimeError(f"{said['error']}: {said['message']}")
                return said["result"]

    def open(self, page: Path) -> None:
        """Load a page."""
        address = page.resolve().as_uri()
        self.ask("browsingContext.navigate", context=self.tab, url=address, wait="complete")

    def run(self, script: str) -> Any:
        """The value of a script's expression, plain values only."""
        target = {"context": self.tab}
        wrapped = f"JSON.stringify({script} ?? null)"
        parameters = {"expression": wrapped, "target": target, "awaitPromise": True}
        answer = self.ask("script.evaluate", **parameters)
        if answer["type"] != "success":
            raise RuntimeError(answer["exceptionDetails"]["text"])
        return json.loads(answer["result"]["value"])

    def wait_for(self, selector: str) -> None:
        """Wait until an element is there; ``RuntimeError`` with what the page says otherwise."""
        end = time.monotonic() + _PATIENCE_S
        while not self.run(f"document.querySelector({json.dumps(selector)}) !== null"):
            if time.monotonic() > end:
                raise RuntimeError(f"no {selector}: {self.run('document.body.innerText')}")
            time.sleep(_POLL_S)

    def click(self, x: float, y: float) -> None:
        """Press and release the mouse at a place of the page, pixels."""
        steps = [
            {"type": "pointerMove", "x": round(x), "y": round(y)},
            {"type": "pointerDown", "button": 0},
            {"type": "pointerUp", "button": 0},
        ]
        source = {"type": "pointer", "id": "mouse", "actions": steps}
        self.ask("input.performActions", context=self.tab, actions=[source])

    def picture(self) -> bytes:
        """What the tab shows, a PNG."""
        shown = self.ask("browsingContext.captureScreenshot", context=self.tab)
        return base64.b64decode(shown["data"])
