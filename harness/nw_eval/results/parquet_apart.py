"""Reads a file of rows in a process that may die, and that may neither grow nor stay.

A checksum tells damage, not malice: whoever makes a file can seal it. Arrow ends its process on
some files and asks for gigabytes on others, and who judges a run should not go down with either.
"""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryFile

from nw_eval.clean import clean
from nw_eval.errors import StoreError
from nw_eval.results.row import Row, from_dict, to_dict

_SECONDS = 60.0
_MEMORY = 2**30  # bytes of address space, on top of what the libraries take
_MOST_ANSWER = 512 * 2**20  # bytes
_FIX = "restore the run's folder from a copy, or run again"


def read_rows_apart(path: Path) -> list[Row]:
    """Return the rows of a Parquet file; as `parquet.read_rows`.

    Raises:
        StoreError: as there; or reading took too long, or ended its process.
    """
    # `-P`: no module comes from the working folder, which may be the run's own.
    command = [sys.executable, "-P", "-m", __name__, str(path)]
    with TemporaryFile() as answer:
        try:
            done = subprocess.run(  # noqa: S603  # Our own module, no shell.
                command,
                stdin=subprocess.DEVNULL,
                stdout=answer,
                stderr=subprocess.DEVNULL,
                timeout=_SECONDS,
                check=False,
            )
        except subprocess.TimeoutExpired:
            raise StoreError(f"{path}: not read within {_SECONDS:g} s", fix=_FIX) from None
        if answer.tell() > _MOST_ANSWER:
            raise StoreError(f"{path} has over {_MOST_ANSWER // 2**20} MiB of rows", fix=_FIX)
        answer.seek(0)
        lines = [json.loads(line) for line in answer if line.endswith(b"\n")]
    if not lines or lines[-1] != "end":
        error = next((line["error"] for line in lines if "error" in line), None)
        if error is not None:
            raise StoreError(clean(error), fix=_FIX)
        raise StoreError(f"{path}: reading it ended with code {done.returncode}", fix=_FIX)
    return [from_dict(line) for line in lines[:-1]]


def _answer(path: Path) -> None:
    """Write the rows of a file as JSON lines, and a last line that says that it is the last."""
    from nw_eval.results.parquet import read_rows

    _limit_memory()
    try:
        lines = [json.dumps(to_dict(row)) for row in read_rows(path)[0]]
    except (StoreError, MemoryError) as error:
        reason = error.said if isinstance(error, StoreError) else f"{path}: no memory to read it"
        lines = [json.dumps({"error": reason})]
    else:
        lines.append('"end"')
    sys.stdout.write("".join(f"{line}\n" for line in lines))


def _limit_memory() -> None:
    import resource

    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0])
    limit = pages * resource.getpagesize() + _MEMORY
    resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
    resource.setrlimit(resource.RLIMIT_CPU, (int(_SECONDS), int(_SECONDS)))


if __name__ == "__main__":
    _answer(Path(sys.argv[1]))
