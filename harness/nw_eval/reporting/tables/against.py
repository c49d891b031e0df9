"""Tables of a drop: what changed against a baseline, scene by scene, and what it is due to.

Perception or control is the answer of `nw-eval attribute`, in words and as a two-by-two.
"""

from __future__ import annotations

from nw_eval.gate.cause import Cause, Effect
from nw_eval.gate.verdict import Comparison, SceneDrop
from nw_eval.plural import plural
from nw_eval.reporting.tables.table import Bar, Table, bounds_header, span, uncorrected
from nw_eval.stats.bank.trials import SUSPECT
from nw_eval.stats.interval import Interval

_SHOWN = 1e6
"""Evidence over which a cell says only that it is over it."""


def baseline_table(found: Comparison | None, *, brief: bool = False) -> Table:
    """Return the drop in each scene, those that fell first; none without a baseline.

    Args:
        found: the comparison.
        brief: for a terminal: without intervals.
    """
    items = () if found is None else sorted(found.scenes, key=_order)
    tiers = any(item.tier != "supporting" for item in items)
    alone = not brief and any(item.interval for item in items)
    return Table(
        title="Against the baseline",
        columns=(
            "scene",
            *(("tier",) if tiers else ()),
            "trials",
            "baseline",
            "candidate",
            "drop",
            *((_alone(found),) if alone and found is not None else ()),
            "evidence",
            "regressed",
            "from waypoint",
        ),
        rows=tuple(_line(item, tiers=tiers, alone=alone) for item in items),
        numbers=frozenset(
            {
                *("trials", "baseline", "candidate", "drop", "evidence", "from waypoint"),
                *(() if found is None else (_alone(found),)),
            }
        ),
        note="" if found is None else _note(found),
        marked="baseline",
        bars=tuple(
            None
            if item.candidate is None or item.baseline is None
            else Bar(value=item.candidate, mark=item.baseline, interval=_left(item), change=True)
            for item in items
        ),
    )


def _alone(found: Comparison) -> str:
    """Return the header of the intervals of drops."""
    return bounds_header(found.alpha_regr, found.alpha_pass)


def _order(item: SceneDrop) -> tuple[bool, float, float, str]:
    return (not item.counts, -item.evidence, -(item.drop or 0.0), item.name)


def _line(item: SceneDrop, *, tiers: bool, alone: bool) -> tuple[str, ...]:
    return (
        item.name,
        *((item.tier,) if tiers else ()),
        str(item.trials),
        "none" if item.baseline is None else f"{item.baseline:.3f}",
        "none" if item.candidate is None else f"{item.candidate:.3f}",
        "" if item.drop is None else f"{item.drop:z.3f}",
        *(
            ("" if item.interval is None or not item.trials else span(item.interval),)
            if alone
            else ()
        ),
        _evidence(item) if item.counts and item.trials else "",
        "yes" if item.named else "",
        "" if item.waypoint is None else str(item.waypoint),
    )


def _left(item: SceneDrop) -> Interval | None:
    """Return the candidate's success that the trials of the scene leave possible."""
    if item.interval is None or item.baseline is None:
        return None
    low, high = (item.baseline - drop for drop in reversed(item.interval))
    return Interval(max(0.0, low), min(1.0, high))


def _evidence(item: SceneDrop) -> str:
    return f"over {_SHOWN:.0f}" if item.evidence > _SHOWN else f"{item.evidence:.3g}"


def _note(found: Comparison) -> str:
    """Return what the columns hold, and what the numbers of evidence mean."""
    judged = sum(item.counts for item in found.scenes)
    known = f"{plural(found.starts, 'start')} in each scene"
    if found.basis == "control":
        known = f"{plural(found.control, 'trial')} that ran beside the candidate"
    means = (
        f"The baseline {found.policy} is {known}, the candidate {plural(found.trials, 'trial')}."
    )
    if found.basis == "same":
        return means
    alone = f"{uncorrected('scene', _alone(found))} "
    return (
        f"{means} {alone if any(item.interval for item in found.scenes) else ''}"
        f"Evidence is against a drop of at most {found.scene_drop:g} in that scene. Evidence >= "
        f"{judged / found.alpha_regr:.0f}: reported as regressed ({plural(judged, 'scene')} share "
        f"an error of {100 * found.alpha_regr:.3g} %). >= {SUSPECT:g}: PASS is held back."
    )


_ANSWERS = {
    "no drop": "nothing to blame",
    "perception": "perception",
    "control": "control",
    "both": "perception and control",
    "cannot tell": "cannot tell",
}


def answer_words(cause: Cause) -> str:
    """Return the answer in a sentence."""
    head = _ANSWERS[cause.answer]
    parts = [
        f"{cause.new} loses {cause.drop.size:.3f} against {cause.old} in "
        + plural(cause.trials, "trial"),
        f"{cause.sight.size:+.3f} by sight {_chance(cause.sight)}",
        f"{cause.control.size:+.3f} by control {_chance(cause.control)}",
    ]
    words = f"{head}: {parts[0]}: {parts[1]}, {parts[2]}"
    return f"{words}; {cause.why}" if cause.why else words


def differences_words(cause: Cause) -> str:
    """Return in what the two policies differ."""
    found = [
        name
        for name, differs in (
            ("the sensors of the world around", cause.apart.sight),
            ("gains, actions or other lines of the card", cause.apart.rest),
            ("the checkpoint", cause.apart.weights),
        )
        if differs
    ]
    return f"They differ in {', '.join(found)}." if found else "They are the same policy."


def cause_table(cause: Cause | None) -> Table:
    """Return the two-by-two; without rows where nothing was blamed."""
    columns = ("control", "sight", "success", "completed", "of those that regressed")
    numbers = frozenset(columns[2:])
    if cause is None:
        return Table(title="Perception or control", columns=columns, rows=(), numbers=numbers)
    names = {"old": f"{cause.old} (old)", "new": f"{cause.new} (new)"}
    return Table(
        title="Perception or control",
        columns=columns,
        rows=tuple(
            (
                names[arm.whose_control],
                names[arm.whose_sight],
                f"{arm.success:.3f}",
                f"{arm.completed} of {cause.trials}",
                f"{arm.regressed} of {cause.regressed}",
            )
            for arm in cause.arms
        ),
        numbers=numbers,
        note=f"{answer_words(cause)}. {differences_words(cause)} Sight is the sensors of the world "
        "around and where cameras sit, control is all the rest; each row is a policy that ran in "
        "the same trials. An effect that is none is named in fewer than "
        f"{cause.error * 100:.0f} % of such comparisons.",
    )


def _chance(effect: Effect) -> str:
    return f"(p {effect.p:.3f})" if effect.p >= 0.001 else "(p < 0.001)"
