"""Helper processes that end at once when the process that started them does, however that died.

    python -m nw_base.files.lifeline MODULE ARGUMENTS

runs a module as a program with its standard input as the lifeline.
"""

from __future__ import annotations

import fcntl
import os
import runpy
import select
import signal
import sys


def hold(line: int) -> None:
    """End this process when the other end of a pipe is closed; for its first line.

    The kernel sends SIGIO when the last writer is gone, which ends the process in the midst of an
    import or of native code, too. `PR_SET_PDEATHSIG` would not do: it means the thread that started
    the process, and helpers are started by threads that end before them.

    Sources: fcntl(2), O_ASYNC and F_SETOWN; `pipe_release` in Linux's fs/pipe.c.

    Args:
        line: file descriptor of the reading end. Nothing is ever written to the other.
    """
    signal.signal(signal.SIGIO, signal.SIG_DFL)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGIO})
    fcntl.fcntl(line, fcntl.F_SETOWN, os.getpid())
    fcntl.fcntl(line, fcntl.F_SETFL, fcntl.fcntl(line, fcntl.F_GETFL) | os.O_ASYNC)
    if select.select([line], [], [], 0)[0]:  # It was gone before this was asked for.
        os._exit(1)


if __name__ == "__main__":
    hold(0)
    runpy.run_module(sys.argv[1], run_name="__main__")
