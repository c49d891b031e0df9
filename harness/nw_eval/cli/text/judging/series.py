"""A bisected series in words."""

from __future__ import annotations

from typing import TYPE_CHECKING

from nw_eval.cli.text.table import aligned
from nw_eval.plural import plural

if TYPE_CHECKING:
    from nw_eval.api.running.reports import RunReport
    from nw_eval.api.series import BisectedSeries
    from nw_eval.gate.bisection import Bisection


def series_page(series: BisectedSeries) -> str:
    """Return the checkpoints that were judged, and which of the series fell first."""
    head = ["", "checkpoint", "against the good one", "drop", "trials", "fell in"]
    lines = [
        [str(place + 1), name, *_cells(series.runs.get(place))]
        for place, name in enumerate(series.checkpoints)
    ]
    judged = plural(len(series.runs), "checkpoint")
    cost = f"{judged} of {len(series.checkpoints)} judged, in {plural(series.trials, 'trial')}"
    words = [] if series.found is None else _sentences(series.found, series.checkpoints)
    table = aligned([head, *lines], right={0, 4})
    return "\n".join([*table, "", *words, f"{cost}; each run in {series.folder}"])


def _cells(run: RunReport | None) -> tuple[str, str, str, str]:
    against = None if run is None else run.verdict.against
    if run is None or against is None:
        return "", "", "", ""
    drop = "" if against.drop is None else f"{against.drop:.3f}"
    if against.interval is not None and against.trials:
        drop += f" ({against.interval.low:.2f} to {against.interval.high:.2f})"
    named = [scene.scene for scene in against.scenes if scene.named]
    return against.word, drop, str(len(run.rows)), ", ".join(named)


def _sentences(found: Bisection, names: tuple[str, ...]) -> list[str]:
    """Return what was found, and what was not looked at."""
    if found.first_fallen is None:
        opened = [names[place] for place, word in found.words.items() if word == "INCONCLUSIVE"]
        if opened:
            return [f"no checkpoint fell beyond doubt; left open: {', '.join(opened)}"]
        return [f"none fell: {names[-1]} passed"]
    first = names[found.first_fallen]
    if len(found.suspects) > 1:
        among = ", ".join(names[place] for place in found.suspects)
        words = [f"the first that fell is one of {among}; {first} fell beyond doubt"]
    elif found.last_good is None:
        words = [f"the first that fell: {first}, the first of the series"]
    else:
        words = [f"the first that fell: {first}; {names[found.last_good]} before it passed"]
    if found.recovered:
        later = ", ".join(names[place] for place in found.recovered)
        words.append(f"the series is not monotone: {later} passed after {first} had fallen")
    elif len(found.words) < found.length:
        words.append("monotone as far as judged; --everyone judges the others too")
    return words
