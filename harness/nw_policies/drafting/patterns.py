"""Values of joints: by regular expressions, as Isaac Lab has them, and in another order."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import cast

from nw_policies.cards.joints import short_name
from nw_policies.drafting.fields import Fields, number_of, numbers_of, texts_of


class Patterns:
    """Values by regular expressions that a joint's name must match in full.

    Args:
        names: short names of the joints, in the order of what is returned.
    """

    def __init__(self, names: Sequence[str]) -> None:
        self.names = tuple(names)

    def values(self, data: Fields, key: str, *, default: float | None = None) -> tuple[float, ...]:
        """Return one number for all joints or one each; empty where some are not said.

        `default` is that of joints which no pattern means, where one means any.
        """
        value = data.get(key)
        if isinstance(value, Fields):
            is_theirs = any(_matches(pattern, name) for pattern in value for name in self.names)
            missing = default if is_theirs else None
            by_joint = [_value_of(name, value, missing) for name in self.names]
            values = () if None in by_joint else tuple(cast("list[float]", by_joint))
        else:
            values = numbers_of(value)
        data.doubt(key, value, readable=bool(values))
        return values

    def motors(
        self, groups: Sequence[Fields], key: str, *, default: float | None = None
    ) -> tuple[float, ...]:
        """Return the values of groups of motors.

        Args:
            groups: the later one counts.
            key: of the value.
            default: of joints without one; None = there is no default.

        Returns:
            One for each joint; empty where some have none, or all have the default.
        """
        motors: dict[str, float] = {}
        for group in groups:
            own = self.of_group(group, key)
            motors |= {name: value for name, value in own.items() if value is not None}
        if motors and default is not None:
            motors = dict.fromkeys(self.names, default) | motors
        if complete := set(motors) == set(self.names):
            values = tuple(motors[name] for name in self.names)
            return () if default is not None and set(values) == {default} else values
        for group in groups:
            group.doubt(key, group.get(key), readable=complete)
        return ()

    def of_group(self, group: Fields, key: str) -> dict[str, float | None]:
        """Return what a group of motors has, by the names of its joints; None for what is unsaid.

        `class_type: null` and `key: null` are unsaid, too.
        """
        value = group.get(key)
        return {
            name: _value_of(name, value) if isinstance(value, Fields) else number_of(value)
            for name in self.names_of(group)
        }

    def names_of(self, group: Fields) -> tuple[str, ...]:
        """Return the joints of a group of motors."""
        listed = texts_of(group.first("joint_names_expr", "target_names_expr")[1])
        return tuple(n for n in self.names if any(_matches(pattern, n) for pattern in listed))


def _value_of(name: str, values: Fields, default: float | None = None) -> float | None:
    matched = matching(values, name)
    return values.number(matched) if matched else default


def matching(values: Fields, name: str) -> str:
    """Return the first pattern that means a joint; empty where none does."""
    return next((pattern for pattern in values if _matches(pattern, name)), "")


def _matches(pattern: str, name: str) -> bool:
    """Whether a pattern of at most 100 characters means a joint, with `_joint` or without."""
    # Brackets, dots, stars and words are all that such patterns have; others could take long.
    if len(pattern) > 100 or pattern.count("*") + pattern.count("+") > 3:
        return False
    try:
        return any(re.fullmatch(pattern, whole) for whole in (f"{name}_joint", name))
    except re.error:
        return False


def reordered(
    values: Sequence[float], names: Sequence[str], wanted: Sequence[str]
) -> tuple[float, ...]:
    """Return values for joints in another order; empty where they are of other joints."""
    by_name = dict(zip(map(short_name, names), values, strict=False))
    if len(values) == 1 or list(names) == list(wanted):
        return tuple(values)
    own = [short_name(name) for name in wanted]
    return tuple(by_name[name] for name in own) if set(own) <= set(by_name) else ()
