"""One run for all tests that ask for it, in whichever worker of pytest-xdist."""

from __future__ import annotations

from datetime import UTC, datetime
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING, Any
from uuid import uuid4

import pytest

from nw_eval.errors import NwEvalError
from nw_eval.pytest_plugin.options import SETTINGS

if TYPE_CHECKING:
    from nw_eval.api import Request, RunReport

_SESSION = "nw_eval_session"
"""Where xdist's controller names the session, among all that it tells a worker."""

_NAME = pytest.StashKey[str]()


def tell_worker(config: pytest.Config, workerinput: dict[str, Any]) -> None:
    """Tell a worker of pytest-xdist which session it works for."""
    workerinput[_SESSION] = config.stash.setdefault(_NAME, _name_session())


def runs_of(config: pytest.Config) -> Runs:
    """Return the runs of a session."""
    if _RUNS not in config.stash:
        config.stash[_RUNS] = Runs(config)
    return config.stash[_RUNS]


def _name_session() -> str:
    """Return a name for a session that no other one has: its time, UTC, and chance."""
    return f"{datetime.now(tz=UTC):%Y%m%dT%H%M%SZ} {uuid4().hex}"


class Runs:
    """The runs of a session, each of which is made when it is first asked for, and once."""

    def __init__(self, config: pytest.Config) -> None:
        self._settings = config.stash[SETTINGS]
        worker: dict[str, Any] | None = getattr(config, "workerinput", None)
        self._sharing = 0 if worker is None else int(worker["workercount"])
        self._session = _name_session() if worker is None else str(worker[_SESSION])
        self._known: dict[tuple[Path, Request], RunReport | NwEvalError] = {}

    def of(self, request: Request) -> RunReport:
        """Return the run of a request in the working folder.

        Raises:
            NwEvalError: it came to no verdict; however often one asks.
            KeyboardInterrupt: it was interrupted.
        """
        key = (Path.cwd(), request)
        if key not in self._known:
            try:
                self._known[key] = self._run(request)
            except NwEvalError as error:
                self._known[key] = error
        found = self._known[key]
        if isinstance(found, NwEvalError):
            raise found.with_traceback(None)
        return found

    def _run(self, request: Request) -> RunReport:
        from nw_eval.pytest_plugin.lock import locked

        folder = self._settings.report_dir / self._name(request)
        if not self._sharing:
            judged = self._begin(request, out=folder)
        else:
            with locked(folder / "pytest.lock"):
                judged = self._join(request, folder)
        if judged.interrupted and judged.verdict.verdict == "INFRASTRUCTURE":
            raise KeyboardInterrupt(
                f"interrupted; continue with nw-eval run --resume {judged.typed_folder}"
            )
        return judged

    def _join(self, request: Request, folder: Path) -> RunReport:
        """Return the run that another worker has made, or go on where it died over it."""
        from nw_eval import api

        if not (folder / "run.json").is_file():
            return self._begin(request, out=folder)
        judged = api.report(folder)
        return judged if judged.info.finished else self._begin(request, resume=folder)

    def _begin(
        self, request: Request, *, out: Path | None = None, resume: Path | None = None
    ) -> RunReport:
        from nw_eval import api
        from nw_eval.pytest_plugin.telling.progress import Log

        return api.run(
            request,
            workers=self._workers,
            out=out,
            resume=resume,
            cache=self._settings.cache,
            listener=Log(),
        )

    @property
    def _workers(self) -> int | None:
        """Processes for trials: this worker's share of the cores, where it is one of several."""
        if self._settings.workers is not None or not self._sharing:
            return self._settings.workers
        from nw_eval.results.machine import usable_cores

        return max(1, usable_cores() // self._sharing)

    def _name(self, request: Request) -> str:
        """Return the name of a run's folder, which is the same for every worker."""
        time, chance = self._session.split()
        mark = sha256(f"{chance} {Path.cwd()} {request}".encode()).hexdigest()[:8]
        name = Path(str(request.suite)).name.partition(".")[0]
        return f"{name}-{time}-{mark}"


_RUNS = pytest.StashKey[Runs]()
