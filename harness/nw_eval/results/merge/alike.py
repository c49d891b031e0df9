"""Whether folders are parts of one run: suite, policy, scenes, engine and plan, field by field."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from nw_eval.errors import IncomparableError, UsageError
from nw_eval.results.merge.source import MergeSource
from nw_eval.results.row import Row

_NAMED = 3  # fields that a sentence names before it says "and more"
_LONGEST = 60  # characters of a value
_ONE_KIND = "run all parts with one suite, policy and nw-eval on one kind of machine"


def check_parts(sources: Sequence[MergeSource]) -> None:
    """Refuse folders that are no parts of one run.

    Raises:
        UsageError: there is none, or one is of a run that was run whole.
        IncomparableError: two differ; naming both, each field, and its values.
    """
    if not sources:
        raise UsageError("nothing to merge", fix="name the folders of all parts of a run")
    for source in sources:
        if not source.parts:
            raise UsageError(
                f"{source.folder.path} is no part of a run: it was run whole",
                fix="leave it out; `nw-eval gate` judges it as it is",
            )
    first, *others = sources
    wanted = _fields(first)
    for other in others:
        fields = _fields(other)
        both = {name: (wanted.get(name), fields.get(name)) for name in (*wanted, *fields)}
        differing = [
            f"{name} is {_short(one)} in {first}, {_short(two)} in {other}"
            for name, (one, two) in both.items()
            if one != two
        ]
        if len(differing) == 1 and differing[0].startswith("baseline.checked"):
            _check_bits(first, other)
        if differing:
            more = f"; and {len(differing) - _NAMED} more" if len(differing) > _NAMED else ""
            raise IncomparableError(
                f"not of one run: {'; '.join(differing[:_NAMED])}{more}",
                fix=_ONE_KIND,
            )


def check_beside(arms: Sequence[tuple[MergeSource, Sequence[Row]]]) -> None:
    """Refuse parts whose machines gave the baseline's policy different bits in one trial.

    All parts ran its first trials, so that such machines show, whatever they are called.

    Args:
        arms: parts, with the rows of the baseline's policy that ran beside them.

    Raises:
        IncomparableError: two differ; naming both, and the trial.
    """
    seen: dict[str, tuple[MergeSource, Row]] = {}
    for source, rows in arms:
        for row in rows:
            earlier, known = seen.setdefault(row.trial_id, (source, row))
            if known.digest != row.digest:
                raise IncomparableError(
                    f"not of one run: trial {row.trial_id} of the baseline's policy "
                    f"{row.policy} has other bits in {earlier} than in {source}",
                    fix=_ONE_KIND,
                )


def _check_bits(one: MergeSource, two: MergeSource) -> None:
    """Refuse two parts that differ in what the baseline's policy showed on their machines.

    Raises:
        IncomparableError: naming both.
    """
    found = {
        source.info.baseline.checked: source
        for source in (one, two)
        if source.info.baseline is not None
    }
    if None in found:
        raise IncomparableError(
            f"{found[None]} ended before the baseline's policy had run on its machine",
            fix=f"--resume {found[None].folder.path} goes on with it",
        )
    if {"bits", "control"} <= set(found):
        raise IncomparableError(
            f"not of one run: the baseline's policy repeats its bits in {found['bits']} and has "
            f"others in {found['control']}, and only with others a part has a control",
            fix=_ONE_KIND,
        )


def _fields(source: MergeSource) -> Mapping[str, Any]:
    """Return whatever the parts of a run have in common, by what messages call it."""
    info = source.info
    baseline = info.baseline
    known = {} if baseline is None else baseline.model_dump(exclude={"path"})
    return {
        **{f"suite.{key}": value for key, value in info.suite.items()},
        "suite_digest": info.suite_digest,
        "policy": info.policy.name,
        "checkpoint": info.policy.checkpoint_digest,
        "card": info.policy.card_digest,
        **{f"scene {name}": scene.digest for name, scene in info.scenes.items()},
        **info.engine,
        "panel": info.panel,
        "drawn_from": info.drawn_from,
        "drawn_for": info.drawn_for,
        **{f"baseline.{key}": value for key, value in known.items()},
        "stop": info.stop,
        "number of parts": source.parts[0].shard.count,
        "plan": source.parts[0].shard.plan,
    }


def _short(value: Any) -> str:
    text = "none" if value is None else str(value)
    return text if len(text) <= _LONGEST else f"{text[: _LONGEST - 3]}..."
