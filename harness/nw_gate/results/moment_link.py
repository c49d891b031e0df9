"""The address of a moment of a trial, on the page that `nw-eval view` serves."""

from __future__ import annotations

import math
from dataclasses import dataclass
from urllib.parse import parse_qs, urlencode, urlsplit

PORT = 8720
"""Where `nw-eval view` listens unless it is told otherwise, so that links in reports lead there."""


@dataclass(frozen=True, kw_only=True)
class MomentLink:
    """A moment of a trial.

    Attributes:
        run: the run's name; empty = whichever is shown.
        trial: the trial's name; empty = whichever is shown.
        time: s.
    """

    run: str = ""
    trial: str = ""
    time: float = 0.0

    @property
    def url(self) -> str:
        """Its address on this machine, or through a tunnel to it."""
        words = {"run": self.run, "trial": self.trial, "t": f"{self.time:.2f}"}
        query = urlencode({name: word for name, word in words.items() if word})
        return f"http://localhost:{PORT}/?{query}"


def read_link(path: str) -> MomentLink | None:
    """Return what a request's path names; None where it names nothing."""
    query = parse_qs(urlsplit(path).query, max_num_fields=16)
    run, trial, time = (query.get(name, [""])[-1] for name in ("run", "trial", "t"))
    if not trial and not time:
        return None
    try:
        seconds = float(time or 0.0)
    except ValueError:
        seconds = 0.0
    return MomentLink(run=run, trial=trial, time=seconds if math.isfinite(seconds) else 0.0)
