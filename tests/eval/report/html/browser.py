"""Chromium without a screen, driven by its DevTools protocol: a page in a real browser."""

import json
import shutil
import subprocess
import tempfile
from base64 import b64decode
from contextlib import contextmanager

from websockets.sync.client import connect

CHROMIUM = shutil.which("chromium")
SECONDS = 240.0


class Browser:
    """One tab of a browser, and all that it said of the page that it shows."""

    def __init__(self, socket):
        self._socket = socket
        self._count = 0
        self.events = []
        for domain in ("Page", "Runtime", "Log", "Network"):
            self.call(f"{domain}.enable")

    def call(self, method, **parameters):
        self._count += 1
        self._socket.send(json.dumps({"id": self._count, "method": method, "params": parameters}))
        while True:
            message = json.loads(self._socket.recv(timeout=SECONDS))
            if message.get("id") == self._count:
                if "error" in message:
                    raise RuntimeError(f"{method}: {message['error']}")
                return message["result"]
            self.events.append(message)

    def show(self, page, *, width=1280, height=900, dark=False):
        """Open a page and wait until it has loaded."""
        scheme = [{"name": "prefers-color-scheme", "value": "dark" if dark else "light"}]
        self.call("Emulation.setEmulatedMedia", features=scheme)
        self.call(
            "Emulation.setDeviceMetricsOverride",
            width=width, height=height, deviceScaleFactor=1, mobile=width < 600,
        )  # fmt: skip
        self.events.clear()
        self.call("Page.navigate", url=page.as_uri())
        self._wait_for("Page.loadEventFired")

    def run(self, expression):
        """Return what an expression of JavaScript comes to, awaited."""
        found = self.call(
            "Runtime.evaluate", expression=expression, awaitPromise=True, returnByValue=True
        )
        if "exceptionDetails" in found:
            raise RuntimeError(found["exceptionDetails"]["exception"].get("description"))
        return found["result"].get("value")

    def picture(self, path, *, most=20000):
        """Write a picture of the whole page, or of its upper part."""
        size = self.call("Page.getLayoutMetrics")["cssContentSize"]
        # What lies outside the window is not drawn, to save time.
        metrics = {"width": size["width"], "height": min(size["height"], most)}
        self.call(
            "Emulation.setDeviceMetricsOverride", deviceScaleFactor=1, mobile=False, **metrics
        )
        clip = {"x": 0, "y": 0, **metrics}
        self.run("new Promise((drawn) => setTimeout(() => requestAnimationFrame(drawn), 300))")
        shot = self.call(
            "Page.captureScreenshot", captureBeyondViewport=True, clip={**clip, "scale": 1}
        )
        path.write_bytes(b64decode(shot["data"]))

    @property
    def complaints(self):
        """Errors and warnings of the console, exceptions, and what the page's policy forbade."""
        self.call("Runtime.evaluate", expression="0")  # All events before its answer are here.
        found = []
        for event in self.events:
            what = event["params"]
            if event["method"] == "Runtime.exceptionThrown":
                found.append(what["exceptionDetails"]["exception"].get("description", "exception"))
            elif event["method"] == "Runtime.consoleAPICalled" and what["type"] != "log":
                found.append(json.dumps(what["args"]))
            elif event["method"] == "Log.entryAdded" and what["entry"]["level"] != "verbose":
                found.append(what["entry"]["text"])
        return found

    @property
    def requests(self):
        """Addresses that were asked for, but for those that hold their data themselves."""
        sent = [event for event in self.events if event["method"] == "Network.requestWillBeSent"]
        urls = [event["params"]["request"]["url"] for event in sent]
        return [url for url in urls if not url.startswith("data:")]

    def _wait_for(self, method):
        while not any(event["method"] == method for event in self.events):
            self.events.append(json.loads(self._socket.recv(timeout=SECONDS)))


@contextmanager
def browser():
    """Start a browser, and end it and forget its profile when done."""
    assert CHROMIUM is not None
    with tempfile.TemporaryDirectory() as profile:
        process = subprocess.Popen(
            [CHROMIUM, "--headless=new", "--no-sandbox", "--remote-debugging-port=0",
             "--disable-gpu", "--hide-scrollbars", f"--user-data-dir={profile}", "about:blank"],
            stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True,
        )  # fmt: skip
        try:
            assert process.stderr is not None
            line = next(line for line in process.stderr if "DevTools listening on" in line)
            root = line.split()[-1]
            with connect(root, max_size=None) as socket:
                socket.send(json.dumps({"id": 1, "method": "Target.getTargets"}))
                targets = json.loads(socket.recv(timeout=SECONDS))["result"]["targetInfos"]
            tab = next(target["targetId"] for target in targets if target["type"] == "page")
            address = f"{root.split('/devtools')[0]}/devtools/page/{tab}"
            with connect(address, max_size=None) as socket:
                yield Browser(socket)
        finally:
            process.terminate()
            process.wait(timeout=SECONDS)
