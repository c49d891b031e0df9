"""What a request may change of a suite for one run."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from pydantic import ValidationError

from nw_eval.errors import UsageError
from nw_eval.request import Request
from nw_eval.suite.model import Suite, new_suite

_CHANGED = ("robot", "policy", "trials", "seed", "record")
"""What a request may say otherwise than the suite, under the suite's names."""


def override(suite: Suite, request: Request) -> Suite:
    """Return a suite with what a request says otherwise; None keeps a setting.

    Robot and seed are part of `Suite.digest`: with another one the trials are others. With another
    policy, number of trials or record they are still the same.

    Raises:
        UsageError: a value cannot be used, for example `trials` of 0.
    """
    wanted = {name: getattr(request, name) for name in _CHANGED}
    return _with(suite, {name: value for name, value in wanted.items() if value is not None})


def override_gate(
    suite: Suite, *, max_drop: float | None = None, tolerate: float | None = None
) -> Suite:
    """Return a suite with other drops in its gate; None keeps a setting.

    Raises:
        UsageError: a drop cannot be used.
    """
    wanted = {"max_drop": max_drop, "tolerate": tolerate}
    changes = {name: value for name, value in wanted.items() if value is not None}
    return _with(suite, {"gate": {**suite.gate.model_dump(), **changes}}) if changes else suite


def _with(suite: Suite, changes: Mapping[str, Any]) -> Suite:
    try:
        return new_suite({**suite.model_dump(by_alias=True), **changes}, suite.source)
    except ValidationError as error:
        faults = "; ".join(
            f"--{_option(item['loc'])} {item['input']!r}: {item['msg'].lower()}"
            for item in error.errors()
        )
        raise UsageError(faults) from None


def _option(location: tuple[int | str, ...]) -> str:
    return str(location[-1]).replace("_", "-")
