"""Keywords by their names until 0.1, which are understood for one release."""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from typing import ParamSpec, TypeVar
from warnings import warn

P = ParamSpec("P")
T = TypeVar("T")


def keywords_were(**names: str) -> Callable[[Callable[P, T]], Callable[P, T]]:
    """Return a decorator of a function some of whose keywords have new names.

    A call with an old name gives a `DeprecationWarning` that says the new one.

    Args:
        names: new names by old ones.
    """

    def decorate(function: Callable[P, T]) -> Callable[P, T]:
        @wraps(function)
        def call(*args: P.args, **keywords: P.kwargs) -> T:
            called = function.__name__
            for old, new in names.items():
                if old not in keywords:
                    continue
                if new in keywords:
                    raise TypeError(f"{called}() got both {old!r} and {new!r}, its name now")
                warn(f"{called}({old}=) is now {called}({new}=)", DeprecationWarning, stacklevel=2)
                keywords[new] = keywords.pop(old)
            return function(*args, **keywords)

        return call

    return decorate
