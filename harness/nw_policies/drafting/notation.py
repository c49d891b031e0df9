"""How a card is written: its names, numbers and values, and a change of it as lines.

Drafts are made of these lines, and a change of a card that helps is told in them.
"""

from __future__ import annotations

import json
import re
from collections.abc import Collection, Sequence
from typing import Any, cast

from pydantic import BaseModel

from nw_base.clean import clean
from nw_policies.cards import Card
from nw_policies.cards.joints import PerJoint
from nw_policies.cards.observations import AnyObservation, ProprioObservation

CHECK = "# CHECK:"
"""Begins every comment that the author of a card must act upon."""
RATE_LINE = f"rate: 10  {CHECK} images a second of the training; 50 = one for each action"
"""Of a camera whose rate no file tells."""
_WORDS = {"null", "true", "false", "yes", "no", "on", "off", "y", "n"}
"""What YAML reads as something else than a word."""


def lines_to_check(draft: str) -> int:
    """Return how many lines of a draft its author must act upon."""
    return sum(CHECK in line for line in draft.splitlines())


def number(value: float) -> str:
    """Return a number as YAML reads it: `1e-05` would be a word there."""
    short = f"{value:g}"
    return f"{value:.12f}".rstrip("0").rstrip(".") if "e" in short else short


def in_brackets(values: Sequence[float]) -> str:
    """Return a list of numbers."""
    return f"[{', '.join(number(value) for value in values)}]"


def one_or_list(values: Sequence[float]) -> str:
    """Return one number if all are equal, else a list."""
    return number(values[0]) if len(set(values)) == 1 else in_brackets(values)


def slug(name: str) -> str:
    """Return a name as cards allow it; "" if nothing is left of it."""
    return re.sub(r"[^a-z0-9._-]+", "-", name.lower()).strip("-._")[:64]


def key(name: str) -> str:
    """Return a name of an input as the key of an observation."""
    return re.sub(r"[.-]", "_", slug(name)) or "obs"


def plain(text: str) -> str:
    """Return text of a file as a comment can hold it: on one line, and not too long."""
    return clean(text, at_most=400)


def quoted(name: str) -> str:
    """Return a name as YAML reads it."""
    if re.fullmatch(r"[A-Za-z_][\w.-]*", name, re.ASCII) and name.lower() not in _WORDS:
        return name
    return json.dumps(name)


def changed_lines(old: Card, new: Card) -> list[str]:
    """Return the lines that differ: robot, `control` and observations.

    Each line is the path of a key, and its new value in YAML; of `terms`, the entry that
    changes, or all of them in another order.
    """
    fields = type(new.control).model_fields
    lines = [] if new.robot == old.robot else [f"robot: {new.robot}"]
    lines += [
        f"control.{key}: {flow(value)}"
        for key in fields
        if (value := getattr(new.control, key)) != getattr(old.control, key)
    ]
    for name, observation in new.observations.items():
        lines += _observation_lines(f"observations.{name}", old.observations[name], observation)
    return lines


def _observation_lines(place: str, old: AnyObservation, new: AnyObservation) -> list[str]:
    lines = [] if new.rate == old.rate else [f"{place}.rate: {new.rate}"]
    if not (isinstance(old, ProprioObservation) and isinstance(new, ProprioObservation)):
        return lines
    if old.layout != new.layout:
        lines.append(f"{place}.terms: {flow(new.terms)}  # instead of `layout: {old.layout}`")
    elif [term.term for term in old.frame_terms] != [term.term for term in new.frame_terms]:
        lines.append(f"{place}.terms: {flow(new.terms)}")
    else:
        pairs = zip(old.frame_terms, new.frame_terms, strict=True)
        lines += [f"{place}.terms: - {flow(term)}" for was, term in pairs if was != term]
    if old.history != new.history:
        lines.append(f"{place}.history: {flow(new.history)}")
    return lines


def flow(value: Any) -> str:
    """Return a value of a card as YAML in one line, without what a key has by default."""
    if isinstance(value, BaseModel):
        fields = value.model_dump(exclude_defaults=True)
        return flow({"term": fields.pop("term"), **fields} if "term" in fields else fields)
    if isinstance(value, dict):
        items = cast("dict[str, Any]", value).items()
        return "{" + ", ".join(f"{flow(key)}: {flow(item)}" for key, item in items) + "}"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(flow(item) for item in cast("Sequence[Any]", value)) + "]"
    if value is None or isinstance(value, bool):
        return json.dumps(value)
    if isinstance(value, float):
        return f"{value:z.9g}"
    # Unquoted, some readers of YAML take a range such as 6:8 for a number of base 60, and the sign
    # that a pattern such as ?L_hip begins with for one of their own.
    text = str(value)
    return json.dumps(text) if ":" in text or text.startswith(("?", "*")) else text


def settings(model: BaseModel, *, but: Collection[str] = ()) -> list[str]:
    """Return `key value` for every key of a card's part that has another value than by default."""
    values = {**{key: getattr(model, key) for key in type(model).model_fields}, **_extra(model)}
    defaults = type(model).model_fields
    return [
        f"{key} {flow(value)}"
        for key, value in values.items()
        if key not in but
        and not (key in defaults and value == defaults[key].get_default(call_default_factory=True))
    ]


def _extra(model: BaseModel) -> dict[str, Any]:
    return dict(model.model_extra or {})


def listed(words: Sequence[str]) -> str:
    """Return words as a sentence lists them: `a, b and c`."""
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} and {words[-1]}"


def per_joint(names: Sequence[str], values: Sequence[float]) -> PerJoint:
    """Return values for joints as a person would write them: one, by type, or by name.

    Args:
        names: short names, such as FR_hip.
        values: one for each name.
    """
    plain = [float(f"{value:.9g}") + 0.0 for value in values]  # + 0.0: no negative zeros.
    if len(set(plain)) == 1:
        return plain[0]
    written: dict[str, float] = {}
    for kind in dict.fromkeys(map(_kind, names)):
        own = {n: v for n, v in zip(names, plain, strict=True) if _kind(n) == kind}
        written |= {kind: next(iter(own.values()))} if len(set(own.values())) == 1 else own
    return written


def _kind(name: str) -> str:
    return name.rsplit("_", 1)[-1]
