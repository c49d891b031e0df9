"""The page of logged trials: shows a moment, plays, and follows links to others."""

from __future__ import annotations

import threading
import time as clock
from typing import Any

import numpy as np

from nw_eval.errors import NwEvalError
from nw_eval.results.moment_link import read_link
from nw_eval.view.drawing import TrialDrawing, aim_along
from nw_eval.view.loading import Shelf
from nw_eval.view.panel import STEP, PanelContent, TrialPanel
from nw_eval.view.served import ServedPage

_TICK = 0.04
"""Seconds between two poses that are sent while it plays."""


class ViewPage(ServedPage):
    """Serves logged trials to browsers.

    Args:
        shelf: the trials.
        trial: the one that is shown first; the first of the shelf if empty.
        start: s, of the timeline.
        port: to listen at; 0 = one that is free.

    Attributes:
        time: of the timeline, s.
        name: of the trial that is shown.
        sent: how often poses were sent.

    Raises:
        PrerequisiteError, UsageError: as `ServedPage`.
        NwEvalError: the first trial cannot be loaded.
    """

    def __init__(self, shelf: Shelf, trial: str = "", *, start: float = 0.0, port: int = 0) -> None:
        self._shelf = shelf
        self._lock = threading.RLock()  # Callbacks come from a pool of threads.
        self._plays = threading.Event()
        self.time, self.sent, self._shown_at = 0.0, 0, 0.0
        self.name = trial or next(iter(shelf.logs))
        loaded = shelf.load(self.name)
        super().__init__(port, self.opened)
        try:
            self._build(loaded, 0)
            self.seek(start)
        except BaseException:
            self.close()
            raise
        self.start(self._move, _TICK)

    @property
    def end(self) -> float:
        """Where the timeline ends, s."""
        return max(trace.end for trace in self._traces)

    def choose(self, name: str, others: int = 0) -> None:
        """Show another trial, at its start; what cannot be loaded is said on the page.

        Args:
            name: of the trial.
            others: trials of the same place that are ghosts beside it.
        """
        with self._lock:
            self.play(wanted=False)
            moment = self.time if name == self.name else 0.0
            try:
                loaded = self._shelf.load(name, others)
            except NwEvalError as error:
                self._note(f"{name} cannot be shown: {error}")
                return
            self.name = name
            self._build(loaded, others)
            self.seek(moment)

    def seek(self, moment: float) -> None:
        """Show a moment, s; what lies outside the timeline is its nearest end."""
        with self._lock:
            self.time = min(max(moment, 0.0), self.end)
            self._drawing.show(self.time)
            self.sent += 1
            self._panel.show(self.time, plays=self.plays)

    def play(self, wanted: bool) -> None:
        """Play from where it is, or from the start if it stands at the end; or pause."""
        with self._lock:
            if wanted and self.time >= self.end - STEP / 2:
                self.seek(0.0)
            self._shown_at = clock.monotonic()
            (self._plays.set if wanted else self._plays.clear)()
            self._panel.show_plays(wanted)

    @property
    def plays(self) -> bool:
        """Whether it plays."""
        return self._plays.is_set()

    def show_mesh(self, wanted: bool) -> None:
        """Show the mesh of the place, or its splat alone."""
        self._drawing.shows_mesh = wanted

    def opened(self, path: str) -> None:
        """Follow the link that a browser came by; the server must not wait for that."""
        threading.Thread(target=self._follow, args=[path], daemon=True).start()

    def _follow(self, path: str) -> None:
        link = read_link(path)
        if link is None:
            return
        with self._lock:
            name = link.trial or self.name
            if link.run and link.run != self._shelf.run:
                self._note(f"the link is of another run, {link.run}: nw-eval view that")
            elif name not in self._shelf.logs:
                self._note(f"there is no log of trial {name} here")
            else:
                if name != self.name:
                    self.choose(name)
                self.play(wanted=False)
                self.seek(link.time)

    def _move(self) -> None:
        with self._lock:
            if self.plays:
                now = clock.monotonic()
                passed, self._shown_at = now - self._shown_at, now
                self.seek(self.time + passed * self._panel.speed)
                if self.time >= self.end:
                    self.play(wanted=False)

    def _build(self, loaded: Any, others: int) -> None:
        traces, splat = loaded
        self._traces, self._loaded, self._others = tuple(traces), loaded, others
        self.server.gui.reset()
        self._drawing = TrialDrawing(self.server, self._traces, splat)
        first = self._traces[0]
        aim_along(self.server.initial_camera, np.vstack([first.trunk[:1], first.waypoints]))
        self._draw_panel("")

    def _note(self, words: str) -> None:
        self.server.gui.reset()
        self.show_mesh(self._loaded[1] is None)
        self._draw_panel(words)
        self._panel.show(self.time, plays=self.plays)

    def _draw_panel(self, note: str) -> None:
        shown = PanelContent(
            names=tuple(self._shelf.logs),
            name=self.name,
            others=self._others,
            most_others=len(self._shelf.beside(self.name)),
            traces=self._traces,
            has_splat=self._loaded[1] is not None,
            note=note,
        )
        self._panel = TrialPanel(self.server.gui, self, shown)
