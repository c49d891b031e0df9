"""Workflow commands: lines of a log by which a step tells GitHub's runner something.

`::name key=value,key=value::message`, escaped as the runner's own toolkit escapes it.
"""

from __future__ import annotations

from nw_eval.clean import clean


def command(name: str, message: str, **properties: str | int | None) -> str:
    """Return a command as one line; what it says is cleaned, so that nothing in it is another one.

    Args:
        name: such as `error`.
        message: any text.
        properties: such as `file` and `line`; those that are None are left out.
    """
    known = {key: value for key, value in properties.items() if value is not None}
    settings = ",".join(f"{key}={_property(str(value))}" for key, value in known.items())
    return f"::{name}{f' {settings}' if settings else ''}::{_data(message)}"


def begin_group(title: str) -> str:
    """Return the line that folds what follows in the log behind a title."""
    return command("group", title)


END_GROUP = "::endgroup::"
"""The line that ends it."""


def _data(text: str) -> str:
    return clean(text).replace("%", "%25")  # Cleaned, it has no line breaks to escape.


def _property(text: str) -> str:
    return _data(text).replace(":", "%3A").replace(",", "%2C")
