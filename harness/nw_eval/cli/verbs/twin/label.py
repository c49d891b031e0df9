"""`nw-eval twin label`."""

from __future__ import annotations

import signal
import threading
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import tyro

from nw_eval.words import Robot

if TYPE_CHECKING:
    from nw_eval.twin.label.labelling import Labelling


@dataclass(frozen=True, kw_only=True)
class LabelScene:
    """Lay the trail through a place in the browser, till Ctrl-C: start, waypoints, task.

    The page scales, turns and crops the place too, shows heights along the trail and what
    go1-parkour, a policy of a go1, can reach, and proposes a trail. Saving writes scene.yaml.
    """

    scene: tyro.conf.Positional[str]
    """A scene folder; with --out any place that a suite can name."""
    out: Path | None = None
    """Label a copy, in this new folder: built-in and fetched places are not edited in place."""
    robot: Robot = "go1"
    """With --out: the robot of the suite that is written beside the copy."""
    port: int = 0
    """Port to listen at, on this machine's own address only; 0 chooses a free one."""
    open: bool = False
    """Open the page in this machine's browser."""

    def __call__(self) -> int:
        from nw_eval.splat.files import read_splat
        from nw_eval.twin.label.copying import own_folder
        from nw_eval.twin.label.labelling import open_labelling
        from nw_eval.twin.label.page.label_page import LabelPage
        from nw_eval.viewing.browser import check_server

        check_server(self.port)
        folder = own_folder(self.scene, self.out, robot=self.robot)
        labelling = open_labelling(folder)
        splat = labelling.place.splat
        saved: list[str] = []

        def on_save(line: str) -> None:
            saved.append(line)
            _say(f"saved {line}")

        with LabelPage(
            labelling, None if splat is None else read_splat(splat), port=self.port, on_save=on_save
        ) as page:
            stop = threading.Event()
            for number in (signal.SIGINT, signal.SIGTERM):
                # Said outright: a shell starts its background jobs with SIGINT ignored.
                signal.signal(number, lambda *_: stop.set())
            _say(f"{folder} is at {page.url}: open that in a browser; Ctrl-C ends it")
            if self.open:
                from nw_eval.cli.terminal.browser import show_address

                show_address(page.url)
            stop.wait()
        _say(_ending(labelling, is_saved=bool(saved)))
        return 0


def _ending(labelling: Labelling, *, is_saved: bool) -> str:
    """Return the last words: what became of the changes, and what to do next."""
    folder = labelling.place.folder
    if not is_saved:
        return "nothing was saved"
    suite = folder / "suite.yaml"
    follows = f"nw-eval run {suite}" if suite.is_file() else f"nw-eval scenes check {folder}"
    changed = "" if labelling.is_saved else "what was changed after the last save is not saved; "
    return f"{changed}next: {follows}"


def _say(line: str) -> None:
    print(f"label: {line}", flush=True)
