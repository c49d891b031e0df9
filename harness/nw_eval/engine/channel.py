"""What comes back from a worker: values of known types, and nothing that runs code.

Workers send pickles, and a pickle may call any function. A checkpoint that has taken its process
over could send one out of the fence; so the names that it may use are counted here.
"""

from __future__ import annotations

import builtins
import io
import os
import pickle  # noqa: TID251 - the one place that reads pickles, by a list of names.
from multiprocessing.connection import Connection, reduce_connection
from multiprocessing.reduction import ForkingPickler
from typing import Any

_KNOWN = frozenset(
    {
        ("pebble.pool.process", "Acknowledgement"),
        ("pebble.pool.process", "TaskProblem"),
        ("pebble.pool.process", "TaskResult"),
        ("pebble.common.types", "RemoteException.rebuild_exception"),
        ("pebble.common.types", "Result"),
        ("pebble.common.types", "ResultStatus"),
        ("nw_eval.rollout.result", "StageSeconds"),
        ("nw_eval.rollout.result", "TrialResult"),
    }
)


class ResultConnection(Connection):
    """The end of a pipe where results arrive."""

    def recv(self) -> Any:
        """Return the next message.

        Raises:
            UnpicklingError: it is not made of what a result is made of.
        """
        data = self.recv_bytes()
        try:
            return _Reader(io.BytesIO(data)).load()
        except Exception as error:
            raise pickle.UnpicklingError(f"a worker sent no result: {error}") from error


class _Reader(pickle.Unpickler):
    def find_class(self, module: str, name: str, /) -> Any:
        """Return a class or function that a result may be made of."""
        known = getattr(builtins, name, None) if module == "builtins" else None
        is_error = isinstance(known, type) and issubclass(known, BaseException)
        if is_error or (module, name) in _KNOWN:
            return super().find_class(module, name)
        raise pickle.UnpicklingError(f"{module}.{name} is no part of it")


def result_pipe(receiver: Connection, sender: Connection) -> tuple[Connection, Connection]:
    """Return the ends of a pipe; what is received in this process is read with care."""
    careful = ResultConnection(os.dup(receiver.fileno()), writable=False)
    receiver.close()
    return careful, sender


# In a worker it is a plain connection again: there it brings the parent's jobs.
ForkingPickler.register(ResultConnection, reduce_connection)
