"""A small table as a file for git, and files read by a process that may neither grow nor stay.

So are the rows of a run: see `parquet`.

A checksum tells damage, not malice: whoever makes a file can seal it. Arrow ends its process on
some files and asks for gigabytes on others, and who judges a run should not go down with either.
The process that reads a small table imports little besides Arrow, so that it takes a fraction of a
second.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from itertools import chain, islice
from pathlib import Path
from tempfile import TemporaryFile
from typing import TYPE_CHECKING, Any, Literal

from nw_base.clean import clean
from nw_base.confinement.family import inherited
from nw_base.errors import StoreError
from nw_base.files.cache import atomic_path
from nw_base.files.inside import bounded_bytes
from nw_gate.results.row import Row, rows_of

if TYPE_CHECKING:
    import pyarrow as pa

_MOST_BYTES = 16 * 2**20  # of a file
_MOST_COLUMN = 64 * 2**20  # bytes of a column, unpacked
_MOST_LINES = 200_000
_MOST_FOREIGN = 1_000_000  # rows of a file of another program


@dataclass(frozen=True, kw_only=True)
class PlainTable:
    """What a file holds, of whatever types; bytes are hex digits."""

    metadata: Mapping[str, str]
    """As `sealed.metadata_of`; empty for a table of somebody else's, of which nothing is read."""
    columns: dict[str, list[Any]]
    """All of one length."""


def write_small_table(path: Path, table: pa.Table, metadata: Mapping[str, str]) -> None:
    """As `sealed.write_table`, in half of the bytes: Arrow's own types are not told once more.

    Raises:
        StoreError: the file cannot be written.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    from nw_gate.results.sealed import labels, sealed

    schema = table.schema.remove_metadata()
    # Where no value repeats, a dictionary repeats them all.
    repeating: Any = [
        field.name for field in schema if not pa.types.is_fixed_size_binary(field.type)
    ]
    with atomic_path(path) as temporary:
        stream = pa.BufferOutputStream()
        with pq.ParquetWriter(
            stream,
            schema,
            compression="zstd",
            version="2.6",
            use_dictionary=repeating,
            write_statistics=False,
            store_schema=False,
        ) as writer:
            writer.write_table(table)
            writer.add_key_value_metadata(labels(metadata))
        temporary.write_bytes(sealed(stream.getvalue().to_pybytes()))


def read_small_table(path: Path, *, fix: str) -> PlainTable:
    """Read a table in a process of its own.

    Args:
        path: the file.
        fix: what to do where it cannot be read.

    Raises:
        StoreError: it is missing, too large, damaged, or ended the process.
    """
    (content,) = chain.from_iterable(_values_apart("table", path, fix=fix))
    return PlainTable(**content)


def read_foreign_table(path: Path, *, fix: str) -> dict[str, list[Any]]:
    """Read a Parquet file of whatever program, in a process of its own: columns by name.

    Raises:
        StoreError: as `read_small_table`.
    """
    (content,) = chain.from_iterable(_values_apart("foreign", path, fix=fix))
    return content


def read_rows_apart(path: Path) -> Iterator[Row]:
    """Yield the rows of a Parquet file, read in a process of its own; as `parquet.read_rows`.

    Raises:
        StoreError: as there; or reading took too long, or ended its process.
    """
    fix = "restore the run's folder from a copy, or run again"
    values = chain.from_iterable(_values_apart("rows", path, fix=fix))
    try:
        yield from rows_of(values, next(values).get("rows_digest"))
    except ValueError as error:
        raise StoreError(f"{path} is damaged: {clean(error, at_most=200)}", fix=fix) from None


def _foreign_table(path: Path) -> dict[str, list[Any]]:
    import pyarrow as pa
    import pyarrow.parquet as pq

    try:
        file = pq.ParquetFile(path)
        rows = file.metadata.num_rows
        # Pictures and lists that somebody keeps beside each episode are not needed here.
        flat = [
            field.name
            for field in file.schema_arrow
            if not pa.types.is_nested(field.type) and not pa.types.is_binary(field.type)
        ]
        read = {} if rows > _MOST_FOREIGN else file.read(columns=flat).to_pydict()
    except (pa.ArrowException, OSError, ValueError, LookupError, TypeError, MemoryError) as error:
        reason = clean(error, at_most=200) or type(error).__name__
        raise StoreError(f"{path} is damaged: {reason}") from None
    if rows > _MOST_FOREIGN:
        raise StoreError(f"{path} has {rows} rows, over {_MOST_FOREIGN}")
    return {
        name: [each if isinstance(each, str | float | int | None) else str(each) for each in values]
        for name, values in read.items()
    }


def small_table(path: Path) -> PlainTable:
    """Read a table in this process.

    Raises:
        StoreError: as `read_small_table`.
    """
    import pyarrow as pa

    from nw_gate.results.sealed import is_foreign, metadata_of, table_of

    try:
        data = bounded_bytes(path, _MOST_BYTES)
        if is_foreign(data):
            return PlainTable(metadata={}, columns={})
        table = table_of(data, most_rows=_MOST_LINES, most_bytes=_MOST_COLUMN)
        metadata = metadata_of(table.schema)
        columns = {
            name: [value.hex() if isinstance(value, bytes) else value for value in values]
            for name, values in table.to_pydict().items()
        }
    # Arrow's exceptions are also ValueError, KeyError, TypeError, MemoryError and OSError.
    except (pa.ArrowException, OSError, ValueError, LookupError, TypeError, MemoryError) as error:
        reason = clean(error, at_most=200) or type(error).__name__
        raise StoreError(f"{path} is damaged: {reason}") from None
    return PlainTable(metadata=metadata, columns=columns)


_SECONDS = 60.0
_MEMORY = 2**30  # bytes of address space, on top of what the libraries take
_MOST_ANSWER = 4 * 2**30  # bytes: of a million rows, as in a journal
_AT_ONCE = 2000  # lines that are parsed together


def _values_apart(
    what: Literal["table", "rows", "foreign"], path: Path, *, fix: str
) -> Iterator[list[Any]]:
    """Yield the JSON values that `_read` reads from a file, in a process of its own.

    They come in portions. Of a process that failed some may come before the error.

    Args:
        what: the file holds.
        path: the file.
        fix: what to do where it cannot be read.

    Raises:
        StoreError: as what reads it; or reading took too long, or ended its process.
    """
    # `-P`: no module comes from the working folder, which may be the run's own.
    command = [sys.executable, "-P", "-m", "nw_base.files.lifeline", __name__, what, str(path)]
    # The other process ends with this one: its standard input is closed then.
    life, ours = os.pipe()
    with TemporaryFile() as written, os.fdopen(life, "rb"), os.fdopen(ours, "wb"):
        try:
            done = subprocess.run(  # noqa: S603  # Our own module, no shell.
                command,
                stdin=life,
                stdout=written,
                stderr=subprocess.DEVNULL,
                timeout=_seconds(path),
                env=inherited(),  # A thread may call this.
                check=False,
            )
        except subprocess.TimeoutExpired:
            raise StoreError(f"{path}: not read within {_seconds(path):g} s", fix=fix) from None
        if written.tell() > _MOST_ANSWER:
            raise StoreError(f"{path} has over {_MOST_ANSWER // 2**20} MiB", fix=fix)
        written.seek(0)
        whole = (line for line in written if line.endswith(b"\n"))
        last: Any = None
        while some := list(islice(whole, _AT_ONCE)):  # Read faster than one by one.
            lines = json.loads(b"[" + b",".join(some) + b"]")
            last = lines[-1]
            if last == "end":
                lines.pop()
            elif isinstance(last, dict) and "error" in last:
                raise StoreError(clean(last["error"]), fix=fix)  # Nothing comes behind it.
            yield lines
    if last != "end":
        raise StoreError(f"{path}: reading it ended with code {done.returncode}", fix=fix)


def _read(what: str, path: Path) -> Iterable[dict[str, Any]]:
    if what == "table":
        yield vars(small_table(path))
        return
    if what == "foreign":
        yield _foreign_table(path)
        return
    from nw_gate.results.parquet import plain_rows

    yield from plain_rows(path)


def _answer() -> None:
    """Write what is read from the file that the process was started with, a line for each value.

    A last line says that it is the last.
    """
    what, path = sys.argv[2], Path(sys.argv[3])
    _limit_memory(path)
    try:
        for value in _read(what, path):
            sys.stdout.write(f"{json.dumps(value)}\n")
    except StoreError as error:
        last = json.dumps({"error": error.message})
    except MemoryError:
        last = json.dumps({"error": f"{path}: no memory to read it"})
    except TypeError:  # A date, say, which no file of ours has.
        last = json.dumps({"error": f"{path} holds something that is neither number nor text"})
    else:
        last = '"end"'
    sys.stdout.write(f"{last}\n")


def _seconds(path: Path) -> float:
    """Return how long reading a file may take: a minute for each 32 MiB, which takes ten seconds.

    A file of another program is soon refused.
    """
    try:
        return _SECONDS * (1 + path.stat().st_size // 2**25)
    except OSError:
        return _SECONDS


def _limit_memory(path: Path) -> None:
    import resource

    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0])
    limit = pages * resource.getpagesize() + _MEMORY
    resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
    most = int(_seconds(path))
    resource.setrlimit(resource.RLIMIT_CPU, (most, most))


if __name__ == "__main__":
    _answer()
