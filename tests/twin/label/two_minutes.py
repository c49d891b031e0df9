"""How long a person takes to scale, level, crop and label a scan, click by click in a browser.

    python tests/twin/label/two_minutes.py SCENE [SCENE ...] --pictures FOLDER

Each scene is a folder that `nw-eval scenes import` wrote; a copy is labelled. The person looks at
the scan, measures a length that they know, levels the floor, crops the room, lays a course of four
waypoints and saves. What hands and thoughts take is the keystroke-level model's (Card, Moran and
Newell, "The Keystroke-Level Model for User Performance Time with Interactive Systems",
Communications of the ACM 23, 1980: an average typist); how long the page takes to answer is
measured. The script's own waiting for a browser without a graphics card is not a person's.
"""

import argparse
import os
import signal
import sys
import tempfile
import threading
import time
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent))

from label_person import _HEIGHT, _WIDTH, Browser, wait

from nw_eval import cli
from nw_scenes.mesh import rotation_matrix
from nw_twin.label import files, label_page

KEY, POINT, PRESS, HOME, THINK = 0.28, 1.1, 0.2, 0.4, 1.35
"""s: a keystroke, pointing with a mouse, a click, a hand from mouse to keyboard, a decision."""
LOOK = 5.0
"""s in which somebody sees what lies where when the page has opened."""
MOST = 120.0
"""s that the published system's authors allow by hand."""


@dataclass
class Clock:
    """What a person has done, and how long it took them, s."""

    steps: list[tuple[str, float]] = field(default_factory=list)

    def took(self, what: str, hands: float, answer: float = 0.0) -> None:
        """Add a step: what hands and thoughts took, and how long the page took to answer."""
        self.steps.append((what, hands + answer))

    @property
    def total(self) -> float:
        """All of it, s."""
        return sum(seconds for _, seconds in self.steps)


class Person:
    """A person at the page.

    Args:
        page: the label page.
        browser: that shows it.
        clock: of their work.
    """

    def __init__(self, page, browser, clock):
        self.labelling, self._browser, self._clock = page._labelling, browser, clock
        self._controls = page.controls
        (client,) = page.server.get_clients().values()
        self._camera = client.camera

    def work(self):
        """Do all of it."""
        self._clock.took("looks at the scan", LOOK)
        self._browser.press("v")  # The mesh alone: a splat is slow without a graphics card.
        self._browser.press("c")
        floor = self.floor()
        pairs = [(a, b) for a in floor for b in floor]
        first, second = max(pairs, key=lambda pair: np.linalg.norm(pair[1] - pair[0]))
        self.measures(first, second)
        self.levels(self.apart(self.floor()))
        self.crops()
        self.lays(self.floor())
        self.saves()

    def floor(self):
        """Return points (N, 3) of the floor that can be seen: where rays through pixels meet it."""
        camera, labelling = self._camera, self.labelling
        R, focal = rotation_matrix(camera.wxyz), _HEIGHT / 2 / np.tan(camera.fov / 2)
        x, y = np.meshgrid(np.linspace(60, _WIDTH - 420, 14), np.linspace(60, _HEIGHT - 60, 12))
        own = np.stack([(x - _WIDTH / 2) / focal, (y - _HEIGHT / 2) / focal, np.ones_like(x)], -1)
        ways = own.reshape(-1, 3) @ R.T
        ways /= np.linalg.norm(ways, axis=1, keepdims=True)
        hits = [labelling.snapped(tuple(camera.position), tuple(way)) for way in ways]
        points = np.array([hit for hit in hits if hit is not None])
        assert len(points) >= 6, "no floor can be seen"
        points = points[np.abs(points[:, 2] - labelling.start.position[2]) < 0.12]
        # What lies there already has handles, which take the clicks beside it.
        state = self.labelling.state
        there = [*state.markers, *state.waypoints, self.labelling.start.position]
        away = np.linalg.norm(points[:, None] - np.array(there)[None], axis=2).min(axis=1)
        return points[away > 0.5]

    @staticmethod
    def apart(points):
        """Return three of some points that span the largest triangle of a few drawn ones."""
        rng, best, most = np.random.default_rng(0), points[:3], 0.0
        for _ in range(300):
            three = points[rng.choice(len(points), 3, replace=False)]
            area = np.linalg.norm(np.cross(three[1] - three[0], three[2] - three[0]))
            best, most = (three, area) if area > most else (best, most)
        return best

    def answered(self, holds):
        """Wait until something holds; return how long that took, s."""
        began = time.monotonic()
        wait(holds)
        return time.monotonic() - began

    def measures(self, first, second):
        """Put markers at the ends of a length that is known, and type the metres."""
        labelling, browser, view = self.labelling, self._browser, self._browser.view
        browser.press("4")
        browser.click(tuple(first))
        browser.click(tuple(second))
        answer = self.answered(lambda: labelling.distance is not None)
        self._clock.took("4, two markers", THINK + KEY + 2 * (THINK + POINT + PRESS), answer)
        metres = round(labelling.distance * 1.02, 2)
        view.get_by_role("tab", name="Scale").click()
        view.get_by_label("It is really, m").fill(str(metres))
        browser.press("Tab")
        before = labelling.state.placement.scale
        view.get_by_role("button", name="Scale the scene").click()
        answer = self.answered(lambda: labelling.state.placement.scale != before)
        hands = 2 * (POINT + PRESS) + THINK + 2 * HOME + KEY * (len(str(metres)) + 1)
        self._clock.took("tab Scale, metres, button", hands + POINT + PRESS, answer)

    def levels(self, three):
        """Click three points of the floor."""
        self._browser.press("5")
        self.answered(lambda: self._controls.click == "floor")
        answer = 0.0
        for number, point in enumerate(three, 1):
            self._browser.click(tuple(point))
            answer += self.answered(lambda n=number: len(self.labelling.state.floor) == n % 3)
        self._clock.took("5, three clicks on the floor", KEY + 3 * (THINK + POINT + PRESS), answer)

    def crops(self):
        """Type a box that leaves out a tenth at each side, and crop to it."""
        view, labelling = self._browser.view, self.labelling
        view.get_by_role("tab", name="Place").click()
        low, high = labelling.mesh.vertices.min(axis=0), labelling.mesh.vertices.max(axis=0)
        keys = 0
        for label, corner in (("Crop from, m", low + 0.05 * (high - low)), ("Crop to, m", high)):
            values = [round(float(value), 1) for value in (*corner[:2], corner[2] + 0.1)]
            values[2] = round(float(low[2] - 0.1), 1) if corner is not high else values[2]
            row = view.get_by_text(label).locator("xpath=ancestor::div[descendant::input][1]")
            for box, value in zip(row.locator("input").all(), values, strict=False):
                box.fill(str(value))
                keys += len(str(value)) + 1
        self._browser.press("Tab")
        before = labelling.state
        view.get_by_role("button", name="Crop to the pink box").click()
        answer = self.answered(lambda: labelling.state is not before)
        hands = 3 * (POINT + PRESS) + 2 * HOME + 6 * THINK + KEY * keys
        self._clock.took("tab Place, six numbers, button", hands, answer)

    def lays(self, floor):
        """Remove the waypoints of the import, and click four along the floor."""
        labelling, browser = self.labelling, self._browser
        browser.view.get_by_role("tab", name="Trail").click()
        old, answer = len(labelling.state.waypoints), 0.0
        for left in reversed(range(old)):
            browser.press("x")
            answer += self.answered(lambda n=left: len(labelling.state.waypoints) == n)
        browser.press("1")
        middle = floor[:, :2].mean(axis=0)
        axis = np.linalg.svd(floor[:, :2] - middle)[2][0]
        aside = np.abs((floor[:, :2] - middle) @ [-axis[1], axis[0]])
        line = floor[aside <= np.sort(aside)[min(len(aside) - 1, max(5, len(aside) // 3))]]
        line = line[np.argsort(line[:, :2] @ axis)]
        shares = (0.1, 0.4, 0.7, 0.95)
        for number, place in enumerate((int(share * (len(line) - 1)) for share in shares), 1):
            browser.click(tuple(line[place]))
            answer += self.answered(lambda n=number: len(labelling.state.waypoints) == n)
        hands = POINT + PRESS + THINK + KEY * (1 + old) + 4 * (THINK + POINT + PRESS)
        self._clock.took(f"tab Trail, {old} waypoints removed, four clicked", hands, answer)

    def saves(self):
        """Save."""
        self._browser.press("Control+s")
        answer = self.answered(lambda: self.labelling.is_saved)
        self._clock.took("Ctrl+S", THINK + 2 * KEY, answer)


def labelled(scene, pictures):
    """Label a copy of a scene; return the clock of it."""
    clock, failures, before = Clock(), [], signal.getsignal(signal.SIGINT)
    pages = []

    class SeenPage(label_page.LabelPage):
        def __enter__(self):
            pages.append(self)
            return super().__enter__()

    def person():
        try:
            wait(lambda: pages and signal.getsignal(signal.SIGINT) is not before)
            with Browser(pages[0], pictures) as browser:
                Person(pages[0], browser, clock).work()
                browser.picture(f"{scene.name}-labelled")
        except BaseException as error:  # noqa: BLE001 - raised again below.
            failures.append(error)
        finally:
            os.kill(os.getpid(), signal.SIGINT)

    with tempfile.TemporaryDirectory() as place:
        copy = Path(place) / scene.name
        files.copy_scene(str(scene), copy)
        seen, label_page.LabelPage = label_page.LabelPage, SeenPage
        thread = threading.Thread(target=person)
        thread.start()
        try:
            with suppress(SystemExit):
                cli.main(["twin", "label", str(copy)])
        finally:
            thread.join()
            label_page.LabelPage = seen
            signal.signal(signal.SIGINT, before)
    if failures:
        raise failures[0]
    return clock


def main():
    """Print each scene's path and how long it takes."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("scenes", nargs="+", type=Path, help="folders of imported scenes")
    parser.add_argument("--pictures", type=Path, required=True, help="folder for pictures")
    words = parser.parse_args()
    words.pictures.mkdir(parents=True, exist_ok=True)
    for scene in words.scenes:
        clock = labelled(scene.resolve(), words.pictures)
        lines = [f"{scene.name}: {clock.total:.0f} s by hand, {MOST:.0f} s allowed"]
        lines += [f"  {seconds:5.1f} s  {what}" for what, seconds in clock.steps]
        sys.stdout.write("\n".join(lines) + "\n")


if __name__ == "__main__":
    main()
