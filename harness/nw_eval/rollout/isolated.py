"""Calls a function in a process of its own: for checkpoints that are themselves programs.

What comes back is JSON, never an object of Python's, so a process that a hostile file has taken
over can say something wrong, but run nothing here.
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Mapping
from multiprocessing import get_context
from multiprocessing.connection import Connection
from typing import Any

from nw_eval import errors
from nw_eval.errors import NwEvalError, PolicyError

TIME_LIMIT = 120.0
"""Seconds; imports take a few of them, a slow disk a few more."""

_ONE_THREAD = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")


def call_isolated(
    function: Callable[..., Any],
    /,
    *,
    subject: str,
    time_limit: float = TIME_LIMIT,
    **arguments: Any,
) -> Any:
    """Call a function in a fresh process and return what it returns.

    Args:
        function: a module's own function, which returns what JSON can hold.
        subject: what is being looked at, for errors.
        time_limit: wall seconds.
        **arguments: plain values.

    Raises:
        NwEvalError: what the function raised, of the same class.
        PolicyError: the process died, or did not come back in time.
    """
    context = get_context("spawn")
    receiver, sender = context.Pipe(duplex=False)
    process = context.Process(target=_answer, args=(sender, function, dict(arguments)), daemon=True)
    process.start()
    sender.close()
    try:
        if not receiver.poll(time_limit):
            raise PolicyError(
                f"{subject}: no answer from the checkpoint within {time_limit:g} s",
                fix="run it on its own: it may wait for something, or be too large",
            )
        try:
            answer = json.loads(receiver.recv_bytes())
        except EOFError:
            process.join()
            raise PolicyError(
                f"{subject}: the process that opened the checkpoint died "
                f"(exit code {process.exitcode})",
                fix="load the checkpoint on its own with an observation of the card's shapes",
            ) from None
    finally:
        receiver.close()
        process.kill()
        process.join()
    if "error" in answer:
        kind = getattr(errors, str(answer["kind"]), NwEvalError)
        raise kind(str(answer["error"]))
    return answer["value"]


def _answer(sender: Connection, function: Callable[..., Any], arguments: Mapping[str, Any]) -> None:
    os.environ.update(dict.fromkeys(_ONE_THREAD, "1"))
    try:
        answer = {"value": function(**arguments)}
    except NwEvalError as error:
        kind = type(error) if type(error).__module__ == errors.__name__ else NwEvalError
        answer = {"error": str(error), "kind": kind.__name__}
    except Exception as error:  # noqa: BLE001 - it is told, and the process ends.
        answer = {"error": f"{type(error).__name__}: {error}", "kind": "PolicyError"}
    sender.send_bytes(json.dumps(answer).encode())
    sender.close()
