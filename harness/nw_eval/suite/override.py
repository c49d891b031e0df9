"""What a request may change of a suite for one run."""

from __future__ import annotations

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
    changes = {name: value for name, value in wanted.items() if value is not None}
    try:
        return new_suite({**suite.model_dump(by_alias=True), **changes}, suite.source)
    except ValidationError as error:
        faults = "; ".join(
            f"--{item['loc'][0]} {item['input']!r}: {item['msg'].lower()}"
            for item in error.errors()
        )
        raise UsageError(faults) from None
