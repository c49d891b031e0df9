"""The page of logged trials: shows a moment, plays, and follows links to others.

Beside a trial stands its panel: its timeline, its robot's own view, what happened when, and plots
of numbers over the seconds before a moment.
"""

from __future__ import annotations

import threading
import time as clock
from collections.abc import Mapping, Sequence
from operator import itemgetter
from typing import Any

import numpy as np

from nw_base.clean import clean
from nw_base.errors import NwEvalError
from nw_eval.view.drawing import STEP, ServedPage, TrialDrawing, aim_along, enlarged, plain
from nw_eval.view.sources import Shelf
from nw_eval.view.trace import Series, Trace, parting
from nw_gate.results.moment_link import read_link

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
            others: trials of the same scene that are ghosts beside it.
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
        """Show the mesh of the scene, or its splat alone."""
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
        way = first.waypoints if len(first.waypoints) else first.trunk[-1:]
        aim_along(self.server.initial_camera, np.vstack([first.trunk[:1], way]))
        self._draw_panel("")

    def _note(self, text: str) -> None:
        self.server.gui.reset()
        self.show_mesh(self._loaded[1] is None)
        self._draw_panel(text)
        self._panel.show(self.time, plays=self.plays)

    def _draw_panel(self, note: str) -> None:
        has_splat = self._loaded[1] is not None
        self._panel = TrialPanel(
            self, self._shelf, self._traces, others=self._others, has_splat=has_splat, note=note
        )


_PLOT_EVERY = 0.25
"""Seconds between two plots that are sent while it plays."""
_SPEEDS = ("0.1", "0.25", "0.5", "1", "2")
_MOST_OTHERS = 8
_EGO = {
    True: "What the policy saw",
    False: "The policy has no camera; from its head",
    None: "From its head",
}
"""Titles of the ego camera's picture, by whether the policy was given it."""


class TrialPanel:
    """Draws the controls, and keeps them at the moment that is shown.

    Args:
        page: that they steer; viser's panel there is empty.
        shelf: the trials that can be chosen.
        traces: the trial that is shown, then its ghosts.
        others: trials of its place that are its ghosts.
        has_splat: of its place.
        note: what else is to be said.

    Attributes:
        heading: what is said above the timeline.
    """

    def __init__(
        self,
        page: ViewPage,
        shelf: Shelf,
        traces: Sequence[Trace],
        *,
        others: int,
        has_splat: bool,
        note: str,
    ) -> None:
        gui: Any = page.server.gui
        self._page, self._traces = page, traces
        self._plotted = 0.0
        self._choices(gui, shelf, others)
        self.heading = "\n\n".join([*_heading(traces), *filter(None, [plain(note)])])
        gui.add_markdown(self.heading)
        end = max(trace.end for trace in traces)
        self._slider = gui.add_slider(
            "Time, s", min=0.0, max=max(STEP, round(end, 3)), step=STEP, initial_value=0.0
        )
        self._slider.on_update(self._on_slider)
        self._button = gui.add_button("Play")
        self._button.on_click(lambda _: page.play(not page.plays))
        steps = gui.add_button_group("Step", ("-10", "-1", "+1", "+10"))
        steps.on_click(lambda _: self._jump(page.time + int(steps.value) * STEP))
        self._speed = gui.add_dropdown("Speed", _SPEEDS, initial_value="1")
        if has_splat:
            mesh = gui.add_checkbox("Mesh", initial_value=False)
            mesh.on_update(lambda _: page.show_mesh(mesh.value))
        label = _EGO[traces[0].is_seen]
        self._ego = gui.add_image(np.zeros((9, 16, 3), np.uint8), label=label)
        self._ego.visible = bool(len(traces[0].frames[0]))
        with gui.add_folder("Events"):
            for moment, words in _events_of(traces):
                button = gui.add_button(f"{moment:.2f} s  {words}")
                button.on_click(lambda _, to=moment: self._jump(to))
        self._plots: list[tuple[Series, Any]] = []
        with gui.add_folder("Plots"):
            for series in traces[0].series:
                self._plots.append((series, _plot_of(gui, series)))

    @property
    def speed(self) -> float:
        """Seconds of the trial in a second."""
        return float(self._speed.value)

    def show(self, moment: float, *, plays: bool) -> None:
        """Put timeline, picture and plots to a moment, s."""
        if abs(self._slider.value - moment) > STEP / 2:
            self._slider.value = round(moment, 3)
        picture = self._traces[0].picture(moment)
        if picture is not None:
            self._ego.image = enlarged(picture)
        now = clock.monotonic()
        if not plays or now - self._plotted > _PLOT_EVERY:
            self._plotted = now
            for series, plot in self._plots:
                plot.data = _window(series, moment)

    def show_plays(self, plays: bool) -> None:
        """Say what the button does."""
        self._button.label = "Pause" if plays else "Play"

    def _choices(self, gui: Any, shelf: Shelf, others: int) -> None:
        name = self._page.name
        if len(shelf.logs) > 1:
            chosen = gui.add_dropdown("Trial", tuple(shelf.logs), initial_value=name)
            chosen.on_update(lambda _: self._page.choose(chosen.value))
        if most := len(shelf.beside(name)):
            beside = gui.add_slider(
                "Others here",
                min=0,
                max=min(most, _MOST_OTHERS),
                step=1,
                initial_value=others,
                hint="Other trials of this scene, as ghosts",
            )
            beside.on_update(lambda _: self._page.choose(name, beside.value))

    def _on_slider(self, event: Any) -> None:
        if event.client is not None:  # Moved by a person.
            self._jump(float(self._slider.value))

    def _jump(self, moment: float) -> None:
        self._page.play(wanted=False)
        self._page.seek(moment)


def _events_of(traces: Sequence[Trace]) -> list[tuple[float, str]]:
    """Return what happened in the first of the trials, and where the others diverge from it."""
    events = list(traces[0].events)
    for trace in traces[1:]:
        apart = parting(traces[0], trace)
        if apart is not None:
            events.append((apart, f"parts from {_who(trace, traces[0])}"))
    return sorted(events, key=itemgetter(0))  # In the log's order where times are the same.


def _heading(traces: Sequence[Trace]) -> list[str]:
    lines = [plain(traces[0].name)]
    for number, trace in enumerate(traces):
        verdict: Mapping[str, str] = trace.logged.verdict
        end = verdict.get("outcome") or verdict.get("error_type") or "no outcome"
        mark = "" if number else "**"
        line = f"{mark}{plain(_who(trace, traces[0]))}{mark}: {plain(end)}"
        if number:
            apart = parting(traces[0], trace)
            line += "; never apart" if apart is None else f"; apart from {apart:.2f} s on"
        lines.append(line)
    return lines


def _who(trace: Trace, first: Trace) -> str:
    """Return the policy of a trial, or the trial itself where that is another."""
    if trace.name != first.name:
        return trace.name
    return clean(trace.logged.job.policy_name or trace.logged.job.policy, at_most=60)


_SECONDS = 4.0
"""Before the moment, that a plot shows."""
_COLOURS = ("#1973f0", "#e8590c", "#2b8a3e", "#8641c4")


def _window(series: Series, moment: float) -> tuple[Any, ...]:
    """Return what a plot shows at a moment, s: times, then a column for each line."""
    last = int(np.searchsorted(series.times, moment + 1e-6, side="right"))
    first = int(np.searchsorted(series.times, moment - _SECONDS))
    rows = slice(first, max(last, first + 1))
    return (series.times[rows], *series.values[rows].T)


def _plot_of(gui: Any, series: Series) -> Any:
    """Add a plot to viser's panel, at the beginning of its series; return its handle."""
    from viser import uplot

    lines = [
        uplot.Series(label=name, stroke=_COLOURS[n % len(_COLOURS)], width=1)
        for n, name in enumerate(_lines_of(series))
    ]
    return gui.add_uplot(
        data=_window(series, 0.0),
        series=(uplot.Series(label="s"), *lines),
        title=series.title,
        legend=uplot.Legend(show=len(lines) <= 3),
        scales={"x": uplot.Scale(time=False, auto=True), "y": uplot.Scale(auto=True)},
        aspect=2.0,
    )


def _lines_of(series: Series) -> tuple[str, ...]:
    return series.names or tuple(str(n) for n in range(series.values.shape[1]))
