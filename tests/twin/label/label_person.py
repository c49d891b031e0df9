"""A person at the page, in a browser without a screen or in none."""

import math
import os
import shutil
import signal
import threading
import time

import numpy as np
import pytest

from nw_eval import cli
from nw_scenes.mesh import rotation_matrix
from nw_twin.label import label_page

CHROMIUM = shutil.which("chromium") or shutil.which("google-chrome")
_FLAGS = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
_SIGNALS = (signal.SIGINT, signal.SIGTERM)
_WIDTH, _HEIGHT = 1180, 860


def wait(holds, seconds=60, *, at=lambda: ""):
    """Wait until something holds."""
    end = time.monotonic() + seconds
    while not holds():
        assert time.monotonic() < end, at()
        time.sleep(0.05)


@pytest.fixture
def label(monkeypatch, capsys):
    """Run the verb, let a person use its page, and interrupt it; return code and output."""
    before = [signal.getsignal(number) for number in _SIGNALS]
    pages, failures = [], []

    class SeenPage(label_page.LabelPage):
        def __enter__(self):
            pages.append(self)
            return super().__enter__()

    monkeypatch.setattr(label_page, "LabelPage", SeenPage)

    def listens(number):
        return "stopped_by_signals" in getattr(signal.getsignal(number), "__qualname__", "")

    def run(*arguments, do=lambda _: None, number=signal.SIGINT):
        pages.clear()
        for other, handler in zip(_SIGNALS, before, strict=True):
            signal.signal(other, handler)

        has_ended = threading.Event()

        def person():
            wait(lambda: has_ended.is_set() or (pages and listens(number)))
            if has_ended.is_set():
                return
            try:
                do(pages[0])
            except BaseException as error:  # noqa: BLE001 - raised again in the test's thread.
                failures.append(error)
            finally:
                os.kill(os.getpid(), number)

        thread = threading.Thread(target=person)
        thread.start()
        try:
            with pytest.raises(SystemExit) as left:
                cli.main(["twin", "label", *map(str, arguments)])
        finally:
            has_ended.set()
            thread.join()
        if failures:
            raise failures[0]
        return left.value.code, capsys.readouterr()

    yield run
    for number, handler in zip(_SIGNALS, before, strict=True):
        signal.signal(number, handler)


class Browser:
    """A browser that shows a page; a context manager.

    Args:
        page: the label page.
        pictures: folder for pictures of it.
    """

    def __init__(self, page, pictures):
        self._page, self._pictures = page, pictures

    def __enter__(self):
        from playwright.sync_api import sync_playwright

        self._play = sync_playwright().start()
        self._browser = self._play.chromium.launch(executable_path=CHROMIUM, args=_FLAGS)
        self.view = self._browser.new_page(viewport={"width": _WIDTH, "height": _HEIGHT})
        self.view.set_default_timeout(120_000)
        self.view.goto(self._page.url)
        self.view.get_by_text("Save (Ctrl+S)").wait_for()
        self.view.wait_for_timeout(8_000)
        return self

    def __exit__(self, *_):
        self._browser.close()
        self._play.stop()

    def press(self, key):
        """Press a key."""
        self.view.keyboard.press(key)
        self.view.wait_for_timeout(300)

    def click(self, point):
        """Click where a point of the world is seen."""
        self.view.mouse.move(*self.pixel(point))
        self.view.mouse.down()
        self.view.wait_for_timeout(150)
        self.view.mouse.up()
        self.view.wait_for_timeout(300)

    def pixel(self, point):
        """Where a point of the world is seen, from the camera as the browser reports it."""
        (client,) = self._page.server.get_clients().values()
        camera = client.camera
        seen = rotation_matrix(camera.wxyz).T @ (np.array(point) - camera.position)
        focal = _HEIGHT / 2 / math.tan(camera.fov / 2)
        return tuple((_WIDTH / 2, _HEIGHT / 2) + focal * seen[:2] / seen[2])

    def shows(self, text):
        """Wait until the page shows a text."""
        self.view.get_by_text(text).first.wait_for()

    def picture(self, name):
        """Keep a picture of the page, for people."""
        self.view.wait_for_timeout(3_000)
        self.view.screenshot(path=self._pictures / f"{name}.png")
