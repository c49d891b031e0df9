"""What searches for a limit cost and how often they err, simulated with the shipped code.

`python tests/gate/limits/limit_cells.py` writes `limit_cells.csv` and `limit_gate_cells.csv` anew.

The three measured curves are those of go1-parkour on 24 initial states a rung: bars,
gaps and stairs.
"""

from __future__ import annotations

import csv
import sys
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from zlib import crc32

import numpy as np

from nw_gate.limits.against import LimitGate, LimitMargins
from nw_gate.limits.curves import Beliefs, Curves
from nw_gate.limits.find import find_limit
from nw_gate.limits.ladder import Ladder
from nw_gate.limits.monotone import find_dip
from nw_gate.limits.search import Search
from nw_gate.limits.wealth import Wealth

LADDERS, STRICT, CHECKED, GATES, MOST = 10_000, 2_000, 100, 300, 120
_AT_ONCE, _LOOKED_AT = 100, 500
TABLE = Path(__file__).with_name("limit_cells.csv")
GATE_TABLE = Path(__file__).with_name("limit_gate_cells.csv")


def _logistic(at: float, scale: float) -> list[float]:
    return [1.0 / (1.0 + float(np.exp((i - at) / scale))) for i in range(14)]


STAIRS = [1, 1, 1, 1, 0.93, 1, 0.86, 0.93, 0.87, 0, 0, 0, 0, 0, 0]
SHAPES: dict[str, list[float]] = {
    "hurdles": [1, 1, 1, 1, 0.93, 0.8, 0.53, 0, 0, 0, 0, 0, 0, 0],
    "gaps": [1, 1, 0.93, 0.9, 0.95, 0.93, 0.79, 0, 0, 0, 0, 0, 0, 0, 0],
    "stairs": STAIRS,
    "cliff": _logistic(7.0, 0.3),
    "logistic at 4.3": _logistic(4.3, 1.0),
    "logistic at 7.5": _logistic(7.5, 1.0),
    "slow": _logistic(7.0, 2.0),
    "all": [1.0] * 14,
    "none": [0.0] * 14,
    "half": [0.5] * 14,
    "below half": [0.49] * 14,
    "lapses": [0.9] * 8 + [0.1] * 6,
    "dip": [1, 1, 1, 0.3, 1, 1, 1, 1, 0, 0, 0, 0, 0, 0],
}
FALLING = tuple(name for name, p in SHAPES.items() if all(np.diff(p) <= 0.0))
# What gates compare with the shapes above.
CANDIDATES: dict[str, list[float]] = {
    "kp x 0.8": [1, 1, 1, 1, 0.93, 0.7, 0.3, 0.05, 0, 0, 0, 0, 0, 0, 0],
    "just too low": [1.0] * 5 + [0.49] * 4 + [0.0] * 5,
    "just not lower": [1.0] * 5 + [0.5] * 3 + [0.0] * 6,
}


@dataclass(frozen=True, kw_only=True)
class LadderCell:
    """What is searched."""

    shape: str
    width: int
    share: float = 0.5
    check: int = 0

    @property
    def ladders(self) -> int:
        """How many are simulated."""
        few = self.share != 0.5 or self.shape == "slow"
        return CHECKED if self.check else STRICT if few else LADDERS


@dataclass(frozen=True, kw_only=True)
class LadderFound:
    """Trials, and shares of the searches in %."""

    trials: float
    p90: float
    undecided: float
    false_lower: float
    false_upper: float
    dip_said: float


@dataclass(frozen=True, kw_only=True)
class GateCell:
    """Which candidate is judged by which baseline, at `max_drop` of two rungs."""

    question: str
    """equal, too low or power."""
    baseline: str
    candidate: str
    width: int = 2


@dataclass(frozen=True, kw_only=True)
class GateFound:
    """Trials of the candidate and of its baseline, and shares of the verdicts in %."""

    trials: float
    baseline_trials: float
    passed: float
    regressed: float


def cells() -> Iterator[LadderCell]:
    """Yield all searches that are recorded."""
    for shape in ("hurdles", "gaps", "stairs"):
        for width in (2, 3):
            yield LadderCell(shape=shape, width=width)
    for shape in ("logistic at 4.3", "logistic at 7.5"):
        for width in (3, 4):
            yield LadderCell(shape=shape, width=width)
    yield LadderCell(shape="slow", width=4)
    for shape in ("cliff", "lapses", "all", "none", "dip"):
        yield LadderCell(shape=shape, width=2)
    for shape in ("half", "below half"):
        yield LadderCell(shape=shape, width=3)
    for shape in ("hurdles", "stairs", "logistic at 7.5"):
        yield LadderCell(shape=shape, width=3, share=0.9)
    for shape in ("dip", "stairs", "logistic at 7.5"):
        yield LadderCell(shape=shape, width=2 if shape != "logistic at 7.5" else 4, check=2)


def gate_cells() -> Iterator[GateCell]:
    """Yield all gates that are recorded."""
    for shape in ("hurdles", "gaps", "stairs", "cliff", "logistic at 7.5", "slow", "half"):
        yield GateCell(question="equal", baseline=shape, candidate=shape)
    yield GateCell(question="equal", baseline="lapses", candidate="just not lower")
    for shape in ("stairs", "cliff", "logistic at 7.5", "slow"):
        yield GateCell(question="too low", baseline=shape, candidate=f"{shape}, 3 lower")
    yield GateCell(question="too low", baseline="lapses", candidate="just too low")
    for width in (2, 3):
        yield GateCell(question="power", baseline="stairs", candidate="kp x 0.8", width=width)
    yield GateCell(question="power", baseline="hurdles", candidate="hurdles, 3 lower")


def rates_of(name: str) -> list[float]:
    """Return the completion rates of a shape, a candidate, or `SHAPE, K lower`."""
    if name.endswith(" lower") and ", " in name:
        shape, _, by = name.rpartition(", ")
        lower = int(by.split()[0])
        return SHAPES[shape][lower:] + [SHAPES[shape][-1]] * lower
    return (SHAPES | CANDIDATES)[name]


def limit_of(rates: list[float], share: float) -> int:
    """Return the hardest rung that is cleared; -1 for none."""
    return max((i for i, rate in enumerate(rates) if rate >= share), default=-1)


def simulate(cell: LadderCell, ladders: int | None = None) -> LadderFound:
    """Search the ladders of a cell: the same ones whenever it is run."""
    rng = np.random.default_rng(crc32(repr(cell).encode()))
    count = ladders or cell.ladders
    found = _checked(cell, rng, count) if cell.check else list(_searched(cell, rng, count))
    trials, size, low, high, said = (np.concatenate(each) for each in zip(*found, strict=True))
    order, limit = np.argsort(trials, kind="stable"), limit_of(SHAPES[cell.shape], cell.share)
    p90 = trials[order][np.searchsorted(size[order].cumsum(), 0.9 * count)]

    def share(what: np.ndarray) -> float:
        return float(100.0 * (size * what).sum() / count)

    return LadderFound(
        trials=float((trials * size).sum() / count),
        p90=float(p90),
        undecided=share(high - low > cell.width),
        false_lower=share(low > limit),
        false_upper=share(high <= limit),
        dip_said=share(said),
    )


def _searched(cell: LadderCell, rng: np.random.Generator, count: int) -> Iterator[tuple[Any, ...]]:
    """Yield trials, number, bounds and dips of the ladders that end together.

    Ladders that had the same results so far are one, with their number.
    """
    rates = np.array(SHAPES[cell.shape], float)
    curves = Curves.over(len(rates), cell.share)
    search = Search(curves=curves, share=cell.share, confidence=0.95, width=cell.width, most=MOST)
    wealth, size = Wealth.at_start(1, len(rates)), np.array([count])
    for trials in range(MOST + 1):
        ended = search.ended(wealth) | (trials == MOST)
        if ended.any():
            those = wealth.some(ended)
            low, high = those.bounds(0.95)
            said = _said(those, size[ended], rng)
            yield np.full(len(low), trials), size[ended], low, high, said
            wealth, size = wealth.some(~ended), size[~ended]
        if not len(size):
            return
        # Some at a time: they stay in the processor's cache.
        parts = [slice(i, i + _AT_ONCE) for i in range(0, len(size), _AT_ONCE)]
        each = [search.beliefs(wealth.some(part)) for part in parts]
        beliefs = Beliefs(*(np.concatenate(arrays) for arrays in zip(*each, strict=True)))
        rung = search.next(wealth, beliefs)
        done = rng.binomial(size, rates[rung])
        sizes = np.r_[done, size - done]
        which = np.flatnonzero(sizes)
        of = which % len(size)
        wealth, beliefs = wealth.some(of), Beliefs(*(each[of] for each in beliefs))
        wealth.bet(rung[of], which < len(size), beliefs, cell.share)
        size = sizes[which]


def _said(wealth: Wealth, size: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Return whether a dip is said; of many ladders, the share of those that are looked at."""
    many = len(size) > _LOOKED_AT
    those = rng.permutation(len(size))[:_LOOKED_AT] if many else np.arange(len(size))
    found = [find_dip(wealth.done[i], wealth.missed[i]) is not None for i in those]
    if many:
        return np.full(len(size), np.average(found, weights=size[those]))
    return np.array(found, float)


def _checked(cell: LadderCell, rng: np.random.Generator, count: int) -> list[tuple[Any, ...]]:
    """Return the same of searches that look for a dip."""
    rates, found = SHAPES[cell.shape], list[tuple[Any, ...]]()
    ladder = Ladder(name=cell.shape, rungs=tuple(range(len(rates))))
    for _ in range(count):
        limit = find_limit(
            ladder,
            lambda trial: bool(rng.random() < rates[trial.rung]),
            width=cell.width,
            check=cell.check,
        )
        row = (len(limit.trials), 1, *limit.ends, limit.dip is not None)
        found.append(tuple(np.array([value]) for value in row))
    return found


def simulate_gate(cell: GateCell, gates: int = GATES) -> GateFound:
    """Judge the candidates of a cell: the same ones whenever it is run."""
    rng = np.random.default_rng(crc32(repr(cell).encode()))
    old, new = rates_of(cell.baseline), rates_of(cell.candidate)
    ladder = Ladder(name=cell.baseline, rungs=tuple(range(len(old))))
    margins = LimitMargins(max_drop=2.0)
    words, trials, before = list[str](), list[int](), list[int]()
    for _ in range(gates):
        baseline = find_limit(
            ladder,
            lambda trial: bool(rng.random() < old[trial.rung]),
            width=cell.width,
            confidence=margins.baseline_confidence,
            most=MOST,
        )
        gate = LimitGate(margins, baseline=baseline, most=MOST)
        while (trial := gate.next) is not None:
            gate.tell(trial, bool(rng.random() < new[trial.rung]))
        words.append(gate.verdict.word)
        trials.append(len(gate.trials))
        before.append(len(baseline.trials))
    return GateFound(
        trials=float(np.mean(trials)),
        baseline_trials=float(np.mean(before)),
        passed=100.0 * words.count("PASS") / gates,
        regressed=100.0 * words.count("REGRESSED") / gates,
    )


def recorded_cells() -> Iterator[tuple[LadderCell, LadderFound]]:
    """Read the table of searches."""
    yield from _read(TABLE, LadderCell, LadderFound)


def recorded_gate_cells() -> Iterator[tuple[GateCell, GateFound]]:
    """Read the table of gates."""
    yield from _read(GATE_TABLE, GateCell, GateFound)


def _read(table: Path, asked: Any, found: Any) -> Iterator[tuple[Any, Any]]:
    with table.open(encoding="utf-8", newline="") as file:
        for line in csv.DictReader(file):
            parts = [
                {
                    name: {"str": str, "int": int, "float": float}[field.type](line[name])
                    for name, field in kind.__dataclass_fields__.items()
                }
                for kind in (asked, found)
            ]
            yield asked(**parts[0]), found(**parts[1])


def _write(table: Path, every: list[Any], found: Iterator[Any]) -> None:
    with table.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        for number, (cell, result) in enumerate(zip(every, found, strict=True)):
            if number == 0:
                writer.writerow([*vars(cell), *vars(result)])
            shares = [f"{value:.2f}" for value in vars(result).values()]
            writer.writerow([*vars(cell).values(), *shares])
            file.flush()


def main(tables: list[str]) -> None:
    """Write one table, `ladders` or `gates`, or both."""
    with ProcessPoolExecutor(2) as pool:
        if "gates" not in tables:
            _write(TABLE, list(cells()), pool.map(simulate, cells()))
        if "ladders" not in tables:
            _write(GATE_TABLE, list(gate_cells()), pool.map(simulate_gate, gate_cells()))


if __name__ == "__main__":
    main(sys.argv[1:])
