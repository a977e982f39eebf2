"""Chromium without a window, driven over its DevTools protocol: what a page logs, shows and looks
like.
"""

import base64
import contextlib
import itertools
import json
import os
import shutil
import subprocess
import tempfile
import time
from pathlib import Path

import pytest

#: Width, height, whether it is a phone.
SIZES = {"phone": (390, 844, True), "desktop": (1440, 900, False)}
NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
FLAGS = [
    "--headless=new",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-dev-shm-usage",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--mute-audio",
    "--hide-scrollbars",
    "--remote-debugging-port=0",
]
PATIENCE_S = 90.0


class Page:
    """One tab. ``errors``: what the console said that is an error."""

    def __init__(self, socket):
        self._socket, self._ids, self.errors, self._loaded = socket, itertools.count(1), [], False
        for domain in ("Page", "Runtime", "Log"):
            self._ask(f"{domain}.enable")

    def _ask(self, method, **parameters):
        number = next(self._ids)
        self._socket.send(json.dumps({"id": number, "method": method, "params": parameters}))
        deadline = time.monotonic() + PATIENCE_S
        while True:
            heard = self._hear(deadline)
            if heard.get("id") == number:
                assert "error" not in heard, heard
                return heard["result"]

    def _hear(self, deadline):
        heard = json.loads(self._socket.recv(timeout=max(0.1, deadline - time.monotonic())))
        method, said = heard.get("method"), heard.get("params", {})
        if method == "Runtime.exceptionThrown":
            self.errors.append(json.dumps(said["exceptionDetails"])[:500])
        elif method == "Log.entryAdded" and said["entry"]["level"] == "error":
            self.errors.append(f"{said['entry']['text']} {said['entry'].get('url', '')}")
        elif method == "Runtime.consoleAPICalled" and said["type"] in ("error", "assert"):
            self.errors.append(json.dumps(said["args"])[:500])
        self._loaded |= method == "Page.loadEventFired"
        return heard

    def open(self, url, size):
        """Show a page as a phone or a desktop does, until it is loaded."""
        width, height, phone = SIZES[size]
        scale = 2 if phone else 1
        how = {"width": width, "height": height, "deviceScaleFactor": scale, "mobile": phone}
        self._ask("Emulation.setDeviceMetricsOverride", **how)
        self._loaded, deadline = False, time.monotonic() + PATIENCE_S
        self._ask("Page.navigate", url=url)
        while not self._loaded:
            self._hear(deadline)

    def value(self, expression):
        """What JavaScript makes of an expression; a promise is awaited."""
        how = {"returnByValue": True, "awaitPromise": True}
        answer = self._ask("Runtime.evaluate", expression=expression, **how)
        assert "exceptionDetails" not in answer, answer
        return answer["result"].get("value")

    def until(self, expression):
        """Wait until an expression is true."""
        deadline = time.monotonic() + PATIENCE_S
        while not self.value(expression):
            assert time.monotonic() < deadline, expression
            time.sleep(0.1)

    def picture(self, path, whole=False):
        """A screenshot as PNG."""
        shot = self._ask("Page.captureScreenshot", captureBeyondViewport=whole)
        Path(path).write_bytes(base64.b64decode(shot["data"]))


@contextlib.contextmanager
def browser():
    """A tab of a fresh Chromium; the test is skipped where there is none."""
    connect = pytest.importorskip("websockets.sync.client", reason="websockets is missing").connect
    program = next(filter(None, map(shutil.which, NAMES)), None)
    if program is None:
        pytest.skip("no Chromium is installed (apt install chromium)")
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as home:
        process = subprocess.Popen(
            [program, *FLAGS, f"--user-data-dir={home}/profile", "about:blank"],
            env=os.environ | {"HOME": home},
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        try:
            with connect(_tab(Path(home) / "profile", process), max_size=None) as socket:
                yield Page(socket)
        finally:
            process.terminate()
            try:
                process.wait(timeout=20)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()


def _tab(profile, process):
    """The address of the first tab."""
    import urllib.request

    said, deadline = profile / "DevToolsActivePort", time.monotonic() + PATIENCE_S
    while time.monotonic() < deadline:
        if process.poll() is not None:
            pytest.skip(f"Chromium ends at once here, with {process.returncode}")
        with contextlib.suppress(OSError, ValueError, StopIteration):
            port = int(said.read_text().split()[0])
            answer = urllib.request.urlopen(f"http://127.0.0.1:{port}/json/list", timeout=5)
            tabs = json.load(answer)
            return next(t["webSocketDebuggerUrl"] for t in tabs if t["type"] == "page")
        time.sleep(0.1)
    pytest.skip("Chromium does not answer here")
    return None
