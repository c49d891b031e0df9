"""Reads a file in a process that may die, and that may neither grow nor stay.

A checksum tells damage, not malice: whoever makes a file can seal it. Arrow ends its process on
some files and asks for gigabytes on others, and who judges a run should not go down with either.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Callable, Iterable
from itertools import islice
from pathlib import Path
from tempfile import TemporaryFile
from typing import Any

from nw_eval.clean import clean
from nw_eval.confinement.environment import inherited
from nw_eval.errors import StoreError

_SECONDS = 60.0
_MEMORY = 2**30  # bytes of address space, on top of what the libraries take
_MOST_ANSWER = 512 * 2**20  # bytes
_AT_ONCE = 2000  # lines that are parsed together


def values_apart(module: str, path: Path, *, fix: str) -> list[Any]:
    """Return the JSON values that a module's `answer` reads from a file, in a process of its own.

    Args:
        module: of ours, which ends with `if __name__ == "__main__": answer(...)`.
        path: the file.
        fix: what to do where it cannot be read.

    Raises:
        StoreError: as the module's reader; or reading took too long, or ended its process.
    """
    # `-P`: no module comes from the working folder, which may be the run's own.
    command = [sys.executable, "-P", "-m", "nw_eval.files.lifeline", module, str(path)]
    # The other process ends with this one: its standard input is closed then.
    life, ours = os.pipe()
    with TemporaryFile() as written, os.fdopen(life, "rb"), os.fdopen(ours, "wb"):
        try:
            done = subprocess.run(  # noqa: S603  # Our own module, no shell.
                command,
                stdin=life,
                stdout=written,
                stderr=subprocess.DEVNULL,
                timeout=_SECONDS,
                env=inherited(),  # A thread may call this.
                check=False,
            )
        except subprocess.TimeoutExpired:
            raise StoreError(f"{path}: not read within {_SECONDS:g} s", fix=fix) from None
        if written.tell() > _MOST_ANSWER:
            raise StoreError(f"{path} has over {_MOST_ANSWER // 2**20} MiB", fix=fix)
        written.seek(0)
        whole = (line for line in written if line.endswith(b"\n"))
        lines: list[Any] = []
        while some := list(islice(whole, _AT_ONCE)):  # Read faster than one by one.
            lines += json.loads(b"[" + b",".join(some) + b"]")
    if not lines or lines[-1] != "end":
        error = next((line["error"] for line in lines if "error" in line), None)
        if error is not None:
            raise StoreError(clean(error), fix=fix)
        raise StoreError(f"{path}: reading it ended with code {done.returncode}", fix=fix)
    return lines[:-1]


def answer(read: Callable[[Path], Iterable[Any]]) -> None:
    """Write what is read from the file that the process was started with, a line for each value.

    A last line says that it is the last.
    """
    path = Path(sys.argv[2])
    _limit_memory()
    try:
        lines = [json.dumps(value) for value in read(path)]
    except StoreError as error:
        lines = [json.dumps({"error": error.message})]
    except MemoryError:
        lines = [json.dumps({"error": f"{path}: no memory to read it"})]
    except TypeError:  # A date, say, which no file of ours has.
        lines = [json.dumps({"error": f"{path} holds something that is neither number nor text"})]
    else:
        lines.append('"end"')
    sys.stdout.write("".join(f"{line}\n" for line in lines))


def _limit_memory() -> None:
    import resource

    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0])
    limit = pages * resource.getpagesize() + _MEMORY
    resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
    resource.setrlimit(resource.RLIMIT_CPU, (int(_SECONDS), int(_SECONDS)))
