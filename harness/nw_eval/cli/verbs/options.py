"""The options that say what is to be run: those of `run` and of `check`."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Annotated

import tyro

from nw_eval.request import Request


@dataclass(frozen=True, kw_only=True)
class Options(Request):
    """A request with its letters. Order and help of the options are those of its fields."""

    suite: tyro.conf.Positional[str | None] = None
    policy: Annotated[str | None, tyro.conf.arg(aliases=["-p"])] = None
    trials: Annotated[int | None, tyro.conf.arg(aliases=["-n"])] = None
    scenes: Annotated[tuple[str, ...] | None, tyro.conf.arg(metavar="[GLOB [GLOB ...]]")] = None
    workers: Annotated[int | None, tyro.conf.arg(aliases=["-j"])] = None
    """Worker processes; the number of cores when absent."""

    @property
    def request(self) -> Request:
        """What is asked for, without how it is done."""
        return Request(**{field.name: getattr(self, field.name) for field in fields(Request)})
