"""What a drop is due to, perception or control: what `nw-eval attribute` says, and its table."""

from __future__ import annotations

from nw_base.plural import plural
from nw_eval.reporting.tables.table import Table
from nw_gate.cause import Cause, Effect

_ANSWERS = {
    "no drop": "no drop to explain",
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
        f"{cause.sight.size:+.3f} by sight ({_how_sure(cause.sight, cause.error)})",
        f"{cause.control.size:+.3f} by control ({_how_sure(cause.control, cause.error)})",
    ]
    text = f"{head}: {parts[0]}: {parts[1]}, {parts[2]}"
    return f"{text}; {cause.why}" if cause.why else text


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
    """Return the ablation; without rows where nothing was attributed."""
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
        f"{cause.error * 100:.0f} % of such comparisons. The ends of an interval are of its "
        "effect alone.",
    )


def _how_sure(effect: Effect, error: float) -> str:
    p = f"p {effect.p:.3f}" if effect.p >= 0.001 else "p < 0.001"
    if effect.interval is None:
        return p
    low, high = effect.interval
    return f"{low:+z.2f} to {high:+z.2f} at {100 * (1 - error):.4g} % each, {p}"
