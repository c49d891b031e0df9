"""What the command line may change of a suite for one run."""

from __future__ import annotations

from typing import Any

from pydantic import ValidationError

from nw_eval.errors import UsageError
from nw_eval.suite.model import Suite, new_suite


def override(
    suite: Suite,
    *,
    robot: str | None = None,
    policy: str | None = None,
    trials: int | None = None,
    seed: int | None = None,
    record: str | None = None,
) -> Suite:
    """Return a suite with some settings replaced; None keeps a setting.

    Robot and seed are part of `Suite.digest`: with another one the trials are others. With another
    policy, number of trials or record they are still the same.

    Raises:
        UsageError: a value cannot be used, for example `trials` of 0.
    """
    given = {
        "robot": robot,
        "policy": policy,
        "trials": trials,
        "seed": seed,
        "record": record,
    }
    changes: dict[str, Any] = {name: value for name, value in given.items() if value is not None}
    try:
        return new_suite({**suite.model_dump(by_alias=True), **changes}, suite.source)
    except ValidationError as error:
        told = "; ".join(
            f"--{item['loc'][0]} {item['input']!r}: {item['msg'].lower()}"
            for item in error.errors()
        )
        raise UsageError(told) from None
