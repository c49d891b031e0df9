"""What the gate does trial by trial, simulated on the committed baselines with the shipped code.

A cell is a kind of gate, a baseline, a number of starts and a policy; of each 2,000 gates are run.
`python tests/gate/stats/baseline/gate_cells.py` writes `gate_cells.csv` anew. `record_gate_page.py`
makes tables of docs/concepts/power.md from it.

The starts of a committed baseline are the population. A fresh claim draws a baseline of M starts
from it in each gate, with replacement, and trials of a candidate beside it: what is true is true of
the population. A panel claim takes M of its starts for all there is, and draws their order alone.
"""

from __future__ import annotations

import csv
import os
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any
from zlib import crc32

import numpy as np

from nw_gate.results.baseline import score
from nw_gate.results.baseline_file import read_baseline
from nw_gate.stats.baseline.baseline_bets import BaselineBets, make_bets
from nw_gate.stats.baseline.evidence import Margins, Reference
from nw_gate.stats.baseline.trials import DrawnTrials, TrialRules, settle_all

GATES = 2000
BASELINES = Path(__file__).parents[4] / "reports" / "baselines"
TABLE = Path(__file__).with_name("gate_cells.csv")
STARTS = (5, 6, 12, 30, 60)
# Of `hurdles-state` and so on: a cell is drawn by its words, which stay as they are.
HURDLES, ALL = "hurdles/go1-parkour", "all/go1-parkour"
TWO_SCENES = "gaps/go1-parkour, first 2"
GAPS, STUDENTS = "gaps/go1-parkour", "gaps/go1-act-depth"
ONE_SCENE, HARD_SCENE = f"{GAPS}, first 1", f"{STUDENTS}, first 1"
# The same successes as coins: all of a trial or nothing of it.
COINS, ONE_COIN = f"{STUDENTS}, all or nothing", f"{ONE_SCENE}, all or nothing"
CLAIMS = ("panel", "panel, as if fresh", "fresh", "control")
KINDS = ("harder", "harder, same starts", "some scenes", "all or nothing")
DROPS = (0.0, 0.05, 0.10, 0.20)


@dataclass(frozen=True, kw_only=True)
class Cell:
    """What is simulated."""

    question: str
    """Which share is wanted: see `QUESTIONS`."""
    claim: str
    """panel, fresh or control."""
    baseline: str
    starts: int
    kind: str
    """How the candidate differs: see `_candidate`."""
    drop: float
    drift: float = 0.0
    """How much less the baseline's policy scores on this machine than its baseline says."""
    alpha_regr: float = 0.01
    rounds: int = 20
    critical: int = 0
    """How many scenes, from the first, are critical."""


@dataclass(frozen=True, kw_only=True)
class Found:
    """Shares of the gates in %, and mean trials."""

    passed: float
    regressed: float
    named: float
    """Where any scene was named."""
    blamed: float
    """REGRESSED, or any scene named."""
    trials: float
    """Judged; of both arms beside a control."""


def cells() -> Iterator[Cell]:
    """Yield all that are recorded."""
    for claim in CLAIMS:
        every = (TWO_SCENES, HURDLES, ALL, GAPS, STUDENTS)
        for baseline in every if claim != "panel, as if fresh" else (TWO_SCENES, HURDLES):
            most = 30 if baseline == STUDENTS else 60
            for starts in STARTS if claim != "control" else (most,):
                if starts <= most:
                    yield from _errors(claim, baseline, starts)
    yield from (
        replace(cell, rounds=60) for claim in CLAIMS for cell in _errors(claim, TWO_SCENES, 60)
    )
    yield from _drifts()
    yield from _powers()
    yield from _few_scenes()


def _few_scenes() -> Iterator[Cell]:
    """Yield suites of one scene with 200 trials, as `gate.rounds` has it, and coins."""
    for baseline in (ONE_SCENE, HARD_SCENE, ONE_COIN, COINS):
        for starts in (30, 60, 400) if baseline != COINS else (30, 60):
            rounds = max(20, starts // 2) if baseline != COINS else 20
            for claim in ("fresh", "control") if starts >= 60 else ("fresh",):
                for cell in _errors(claim, baseline, starts):
                    if cell.critical <= 1:
                        yield replace(cell, rounds=rounds)
        for drop in DROPS:
            kind = "harder" if baseline in (ONE_SCENE, HARD_SCENE) else "all or nothing"
            yield Cell(
                question="power",
                claim="fresh",
                baseline=baseline,
                starts=60 if baseline == COINS else 400,
                kind=kind,
                drop=drop,
                rounds=20 if baseline == COINS else 200,
            )


def _errors(claim: str, baseline: str, starts: int) -> Iterator[Cell]:
    """Yield policies that are just not, or just, to be convicted, or to pass."""
    cell = Cell(
        question="equal", claim=claim, baseline=baseline, starts=starts, kind="equal", drop=0.0
    )
    yield cell
    yield replace(cell, critical=2)
    for kind in ("harder", "some scenes", "all or nothing"):
        yield replace(cell, question="at max_drop", kind=kind, drop=0.10)
        yield replace(cell, question="at tolerate", kind=kind, drop=0.02)
    yield replace(cell, question="at scene_drop", kind="every scene", drop=0.10)


def _drifts() -> Iterator[Cell]:
    """Yield machines on which the baseline's policy is worse or better than its baseline says."""
    for baseline in (HURDLES, ALL, GAPS):
        cell = Cell(
            question="equal",
            claim="control",
            baseline=baseline,
            starts=60,
            kind="harder",
            drop=0.0,
            drift=0.05,
        )
        yield cell
        yield replace(cell, question="at max_drop", drop=0.10, drift=-0.03)


def _powers() -> Iterator[Cell]:
    """Yield policies of all drops, at the default alpha_regr and at 5 %."""
    for claim in ("panel", "fresh", "control"):
        for baseline in (HURDLES, ALL, GAPS, STUDENTS):
            for alpha in (0.01, 0.05) if claim != "control" else (0.01,):
                for drop in DROPS:
                    for kind in KINDS:
                        yield Cell(
                            question="power",
                            claim=claim,
                            baseline=baseline,
                            starts=30 if baseline == STUDENTS else 60,
                            kind=kind,
                            drop=drop,
                            alpha_regr=alpha,
                        )


def simulate(cell: Cell, gates: int = GATES) -> Found:
    """Run the gates of a cell: the same ones whenever it is run, some at a time for speed."""
    parts = [_some(cell, part, 200) for part in range(gates // 200)]
    return Found(
        **{name: float(np.mean([vars(part)[name] for part in parts])) for name in vars(parts[0])}
    )


def _some(cell: Cell, part: int, gates: int) -> Found:
    rng = np.random.default_rng([crc32(repr(cell).encode()), part])
    population, waypoints = scores_of(cell.baseline)
    scenes, size = population.shape
    rounds = min(cell.rounds, cell.starts)
    drawn, starts = _draw(rng, scenes, cell.starts, rounds * scenes, gates)
    margins, baseline = Margins(), Reference.control(scenes)
    if cell.claim.startswith("panel"):
        panel = population[:, np.argsort(rng.random(size))[: cell.starts]]
        candidate = _on_a_panel(panel, waypoints, cell, rng)
        drop = float(panel.mean() - candidate.mean())
        while cell.question == "at max_drop" and not 0.02 < drop < 0.3:  # On a small panel.
            candidate = _on_a_panel(panel, waypoints, cell, rng)
            drop = float(panel.mean() - candidate.mean())
        if cell.question == "at max_drop":
            margins = Margins(max_drop=drop, tolerate=0.0)
        elif cell.question == "at tolerate":
            margins = Margins(tolerate=max(drop, 0.0), max_drop=max(drop, 0.10))
        elif cell.question == "at scene_drop":
            most = float((panel - candidate).mean(axis=1).max())
            margins = Margins(scene_drop=max(most, 0.0))
        baseline, c, b = Reference.of(panel), candidate[drawn, starts], panel[drawn, starts]
        baseline = baseline.fresh() if cell.claim == "panel, as if fresh" else baseline
        baseline = replace(baseline, bets=_bets(panel, waypoints, margins))
    elif cell.claim == "fresh":
        which = rng.integers(0, size, (gates, scenes, cell.starts))
        baselines = np.take_along_axis(population[None], which, axis=2)
        chosen = which[np.arange(gates)[:, None], drawn, starts]
        c = _candidate(population, waypoints, cell, rng)(drawn, chosen)
        bets = _bets(baselines, waypoints, margins)
        baseline, b = Reference(means=baselines.mean(axis=2), bets=bets), population[drawn, chosen]
    else:
        chosen = rng.integers(0, size, drawn.shape)
        drift = replace(cell, kind="harder", drop=cell.drift)
        if cell.drift < 0:
            b = _better(population, -cell.drift, rng)(drawn, chosen)
        elif cell.drift > 0:
            b = _candidate(population, waypoints, drift, rng)(drawn, chosen)
        else:
            b = population[drawn, chosen]
        below = replace(cell, drop=cell.drop + cell.drift)
        c = _candidate(population, waypoints, below, rng)(drawn, chosen)
    tiers = tuple("critical" if s < cell.critical else "supporting" for s in range(scenes))
    rules = TrialRules(tiers=tiers, margins=margins, alpha_regr=cell.alpha_regr)
    decisions = settle_all(baseline, DrawnTrials(scenes=drawn, candidate=c, baseline=b), rules)
    words = np.array([decision.word for decision in decisions])
    named = np.array([bool(decision.named) for decision in decisions])
    arms = 2 if cell.claim == "control" else 1
    return Found(
        passed=100 * float((words == "PASS").mean()),
        regressed=100 * float((words == "REGRESSED").mean()),
        named=100 * float(named.mean()),
        blamed=100 * float((named | (words == "REGRESSED")).mean()),
        trials=arms * float(np.mean([decision.trials for decision in decisions])),
    )


def _bets(scores: np.ndarray, waypoints: np.ndarray, margins: Margins) -> BaselineBets:
    return make_bets(
        scores, waypoints, max_drop=margins.max_drop, tolerate=margins.tolerate, by_start=True
    )


def baseline_of(baseline: str) -> str:
    """Return `SUITE/NAME` of the committed baseline that a cell means."""
    return baseline.replace("/", "-state/")


@cache
def scores_of(baseline: str) -> tuple[np.ndarray, np.ndarray]:
    """Return success from each start, shape (S, M), and the waypoints of each scene, shape (S,)."""
    name, _, coins = baseline.partition(", all or ")
    name, _, few = name.partition(", first ")
    saved = read_baseline(BASELINES / f"{baseline_of(name)}.parquet")
    panel = [*saved.panels[0].by_stratum.values()]
    panel = panel[: int(few) if few else None]
    scores = np.array([[score(start) for start in starts] for starts in panel], dtype=np.float64)
    waypoints = np.array([starts[0].waypoints_total for starts in panel])
    if coins:
        # Of each scene as many starts as its mean success is a share of them.
        mean = np.rint(scores.mean(axis=1, keepdims=True) * scores.shape[1])
        scores, waypoints = (
            (np.arange(scores.shape[1]) < mean).astype(np.float64),
            waypoints * 0 + 1,
        )
    return scores, waypoints


Draw = Callable[[np.ndarray, np.ndarray], np.ndarray]


def _draw(
    rng: np.random.Generator, scenes: int, starts: int, budget: int, gates: int
) -> tuple[np.ndarray, np.ndarray]:
    """Return scenes and starts in random order without replacement, each shape (gates, budget)."""
    orders = np.argsort(rng.random((gates, scenes * starts)), axis=1)[:, :budget]
    return orders // starts, orders % starts


def _candidate(
    population: np.ndarray, waypoints: np.ndarray, cell: Cell, rng: np.random.Generator
) -> Draw:
    """Return what draws the candidate's success, given scenes and starts of the population.

    Its mean over the population is less than the baseline's by `cell.drop`, exactly.
    """
    size, kind, drop = population.shape[1], cell.kind, cell.drop
    means = population.mean(axis=1)

    def another(at: np.ndarray) -> np.ndarray:
        return rng.integers(0, size, at.shape)

    if kind == "equal":
        return lambda at, _: population[at, another(at)]
    if kind == "harder":
        harder = _harder(population, waypoints, drop, rng)
        return lambda at, _: harder(at, another(at))
    if kind == "harder, same starts":
        return _harder(population, waypoints, drop, rng)
    if kind == "all or nothing":
        chances = means * (1 - drop / means.mean())
        return lambda at, _: (rng.random(at.shape) < chances[at]).astype(np.float64)
    shares = np.minimum(drop / np.maximum(means, 1e-9), 1.0)
    if kind == "some scenes":
        hit = np.argsort(-means, kind="stable")[:: 4 if drop <= 0.1 else 2]
        shares = np.zeros(len(means))
        shares[hit] = drop * len(means) / means[hit].sum()
    return lambda at, _: np.where(
        rng.random(at.shape) < shares[at], 0.0, population[at, another(at)]
    )


def _harder(
    population: np.ndarray, waypoints: np.ndarray, drop: float, rng: np.random.Generator
) -> Draw:
    """Return what keeps each waypoint that the baseline reached with one chance, in order."""
    reached = np.rint(population * waypoints[:, None]).astype(np.intp)
    kept = _root(lambda q: _mean_kept(reached, waypoints, q), population.mean() - drop)

    def draw(at: np.ndarray, start: np.ndarray) -> np.ndarray:
        found, luck = np.zeros(at.shape), rng.random(at.shape)
        for step in range(1, int(waypoints.max()) + 1):
            found += (luck < kept**step) & (step <= reached[at, start])
        return found / waypoints[at]

    return draw


def _better(population: np.ndarray, rise: float, rng: np.random.Generator) -> Draw:
    """Return what draws success that is better by `rise`: some failures are made good."""
    share = rise / (1.0 - population.mean())
    return lambda at, start: np.where(rng.random(at.shape) < share, 1.0, population[at, start])


def _on_a_panel(
    panel: np.ndarray, waypoints: np.ndarray, cell: Cell, rng: np.random.Generator
) -> np.ndarray:
    """Return a candidate's success from every start of a panel, shape (S, M)."""
    if cell.kind == "equal":  # No scene's mean differs: the policy is equal on this panel.
        return rng.permuted(panel, axis=1)
    places = np.indices(panel.shape)
    return _candidate(panel, waypoints, cell, rng)(places[0], places[1])


def _mean_kept(reached: np.ndarray, waypoints: np.ndarray, kept: float) -> float:
    """Return mean success where each waypoint that was reached is kept with this chance."""
    sums = np.cumsum([0.0, *(kept**step for step in range(1, int(waypoints.max()) + 1))])
    return float((sums[reached] / waypoints[:, None]).mean())


def _root(rises: Callable[[float], float], value: float) -> float:
    low, high = 0.0, 1.0
    for _ in range(60):
        middle = (low + high) / 2
        low, high = (middle, high) if rises(middle) < value else (low, middle)
    return high


def recorded_cells() -> Iterator[tuple[Cell, Found]]:
    """Read the table."""
    with TABLE.open(encoding="utf-8", newline="") as file:
        for line in csv.DictReader(file):
            values: dict[str, Any] = {
                name: value if name in {"question", "claim", "baseline", "kind"} else float(value)
                for name, value in line.items()
            }
            cell = {name: values.pop(name) for name in Cell.__dataclass_fields__}
            whole = {name: int(cell[name]) for name in ("starts", "rounds", "critical")}
            yield Cell(**{**cell, **whole}), Found(**values)


def _politely(cell: Cell) -> Found:
    return simulate(cell)


def main() -> None:
    """Write the table."""
    every = list(cells())
    with ProcessPoolExecutor(2, initializer=os.nice, initargs=(15,)) as pool:
        found = list(pool.map(_politely, every, chunksize=4))
    names = [*Cell.__dataclass_fields__, *Found.__dataclass_fields__]
    with TABLE.open("w", encoding="utf-8", newline="") as file:
        table = csv.writer(file, lineterminator="\n")
        table.writerow(names)
        for cell, result in zip(every, found, strict=True):
            shares = [f"{value:.2f}" for value in vars(result).values()]
            table.writerow([*vars(cell).values(), *shares])


if __name__ == "__main__":
    main()
