"""In which order a candidate meets the starts of a bank: the same for who runs and who judges."""

from __future__ import annotations

from collections.abc import Sequence
from hashlib import sha256

from nw_eval.errors import IncomparableError
from nw_eval.results.bank.start import Stratum
from nw_eval.results.provenance import PolicyInfo, RunInfo
from nw_eval.stats.bank import order_of_starts, order_of_trials
from nw_eval.suite.model import Suite, new_suite
from nw_eval.suite.trials import DrawnStart

_FRESH = 1000
"""Starts in each scene of which fresh ones are drawn, so that a run with more trials begins with
those of one with fewer. Which of them a trial has does not matter: nobody has met any."""


def drawn_order(run: RunInfo, strata: Sequence[Stratum], rounds: int) -> list[DrawnStart]:
    """Return all trials of a run in the order in which they are judged against a baseline.

    Args:
        run: what says how its order was drawn.
        strata: scenes, and what is changed there, of the run.
        rounds: trials of each on average.

    Raises:
        IncomparableError: it was drawn in another way, by an older nw-eval.
    """
    # Of fresh starts no bank drew any, and yet the first ones of each scene were judged.
    if run.run < 2 and (run.drawn_from is not None or run.baseline is not None):
        raise IncomparableError(
            f"run {run.id} was drawn round by round by an older nw-eval, and this one judges trial "
            "by trial",
            fix="run it again",
        )
    order = {"candidate": run.drawn_by, "suite_digest": run.suite_digest}
    if (run.is_recheck or run.goes_by_rounds) and run.drawn_from is not None:
        return draw_rounds(strata, run.drawn_from, rounds, **order)
    if run.drawn_from is None and run.panel == "fresh" and run.baseline is not None:
        return draw_fresh(strata, rounds, **order)
    starts = rounds if run.drawn_from is None else run.drawn_from
    return draw_trials(strata, starts, rounds, **order)


def draw_trials(
    strata: Sequence[Stratum], starts: int, rounds: int, *, candidate: str, suite_digest: str
) -> list[DrawnStart]:
    """Return the first `rounds` x S of all pairs of a stratum and a start, in random order.

    Args:
        strata: scenes, and what is changed there, shape (S,).
        starts: M, of each.
        rounds: trials of each on average.
        candidate: who is judged, by its `key`: the order is one for each network with its card.
        suite_digest: of the suite.
    """
    order = order_of_trials(
        [_label(stratum) for stratum in strata],
        starts,
        candidate_digest=candidate,
        suite_digest=suite_digest,
    )
    return [(*strata[which], start) for which, start in order[: rounds * len(strata)]]


def draw_fresh(
    strata: Sequence[Stratum], rounds: int, *, candidate: str, suite_digest: str
) -> list[DrawnStart]:
    """Return as `draw_trials` does trials 0, 1, ... of each stratum: starts that nobody has met."""
    met = dict.fromkeys(strata, 0)
    found: list[DrawnStart] = []
    most = max(_FRESH, rounds)
    for scene, cell, _ in draw_trials(
        strata, most, rounds, candidate=candidate, suite_digest=suite_digest
    ):
        found.append((scene, cell, met[scene, cell]))
        met[scene, cell] += 1
    return found


def draw_rounds(
    strata: Sequence[Stratum], starts: int, rounds: int, *, candidate: str, suite_digest: str
) -> list[DrawnStart]:
    """Return trials round by round: one start of every stratum, drawn from all of its starts.

    That is how starts of the baseline's own policy run again: some of each scene. Arguments are
    those of `draw_trials`.
    """
    ordered = sorted(strata)
    columns = [
        order_of_starts(
            starts, candidate_digest=candidate, suite_digest=suite_digest, scene=_label(stratum)
        )[:rounds]
        for stratum in ordered
    ]
    return [
        (*stratum, start)
        for drawn in zip(*columns, strict=True)
        for stratum, start in zip(ordered, drawn, strict=True)
    ]


def _label(stratum: Stratum) -> str:
    scene, cell = stratum
    return scene + "".join(f" {axis}={value!r}" for axis, value in cell)


def fresh_seed(candidate: PolicyInfo, suite: Suite) -> int:
    """Return the seed of the starts that only this candidate meets in a suite, 0 to 2^63 - 1.

    It is the first 63 bits of sha256("fresh/<checkpoint digest>/<card digest>/<suite digest>"), the
    digest being that of the suite with seed 0. So nobody chooses it: a checkpoint has one fresh
    panel in a suite, whatever panel is pinned there.

    Args:
        candidate: who is judged.
        suite: what it is to meet, with any seed.
    """
    unseeded = new_suite({**suite.model_dump(by_alias=True), "seed": 0}).digest
    text = f"fresh/{candidate.key}/{unseeded}"
    return int.from_bytes(sha256(text.encode()).digest()[:8], "big") >> 1
