"""Rows in one Parquet file: the explicit Arrow schema, written whole or not at all."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from nw_eval.cache import atomic_path
from nw_eval.errors import StoreError
from nw_eval.results.row import Row, from_dict, to_dict

SCHEMA_VERSION = "1"
"""Raised when a column changes its meaning; new columns may be added without."""

_ADDED = frozenset({"contact_s"})
"""Columns that came later; in older files a row has what it has by default."""

_WORD = pa.dictionary(pa.int32(), pa.string())

SCHEMA = pa.schema(
    [
        pa.field("trial_id", pa.string(), nullable=False),
        pa.field("suite", _WORD, nullable=False),
        pa.field("scene", _WORD, nullable=False),
        pa.field("task", _WORD, nullable=False),
        pa.field("seed_index", pa.int32(), nullable=False),
        pa.field("seed", pa.uint64(), nullable=False),
        pa.field("policy", _WORD, nullable=False),
        pa.field("arm", _WORD, nullable=False),
        pa.field("attempt", pa.int32(), nullable=False),
        pa.field("perturbation", pa.map_(pa.string(), pa.float64()), nullable=False),
        pa.field("status", _WORD, nullable=False),
        pa.field("outcome", _WORD, nullable=False),
        pa.field("end_reason", _WORD, nullable=False),
        pa.field("completed", pa.bool_(), nullable=False),
        pa.field("fraction", pa.float64()),
        pa.field("waypoints_reached", pa.int32(), nullable=False),
        pa.field("waypoints_total", pa.int32(), nullable=False),
        pa.field("waypoint_times", pa.list_(pa.float32()), nullable=False),
        pa.field("steps", pa.int32(), nullable=False),
        pa.field("sim_s", pa.float64(), nullable=False),
        pa.field("physics_s", pa.float64(), nullable=False),
        pa.field("render_s", pa.float64(), nullable=False),
        pa.field("policy_s", pa.float64(), nullable=False),
        pa.field("log_s", pa.float64(), nullable=False),
        pa.field("wall_s", pa.float64(), nullable=False),
        pa.field("coverage_min", pa.float64()),
        pa.field("coverage_mean", pa.float64()),
        pa.field("state_digest", pa.string(), nullable=False),
        pa.field("action_digest", pa.string(), nullable=False),
        pa.field("checkpoint_digest", pa.string(), nullable=False),
        pa.field("scene_digest", pa.string(), nullable=False),
        pa.field("cached", pa.bool_(), nullable=False),
        pa.field("host", _WORD, nullable=False),
        pa.field("mcap_path", pa.string(), nullable=False),
        pa.field("mcap_bytes", pa.int64(), nullable=False),
        pa.field("error_type", _WORD, nullable=False),
        pa.field("error_text", pa.string(), nullable=False),
        pa.field("contact_s", pa.float64(), nullable=False),
    ]
)


def write_rows(path: Path, rows: Iterable[Row], metadata: Mapping[str, str]) -> None:
    """Write rows, sorted by trial, with `nw.<key>` metadata in the schema.

    Args:
        path: appears whole or not at all; an older file is replaced.
        rows: in any order.
        metadata: plain text by key without the prefix, such as `suite_digest`.

    Raises:
        StoreError: the file cannot be written.
    """
    ordered = sorted(rows, key=lambda row: (row.trial_id, row.arm))
    told = {"schema_version": SCHEMA_VERSION, **metadata}
    schema = SCHEMA.with_metadata({f"nw.{key}": value for key, value in sorted(told.items())})
    table = pa.Table.from_pylist([to_dict(row) for row in ordered], schema=schema)
    try:
        with atomic_path(path) as temporary:
            # Fixed options, so that equal rows give equal bytes with one library version.
            pq.write_table(table, temporary, compression="zstd", version="2.6")
    except OSError as error:
        raise StoreError(
            f"cannot write {path}: {error.strerror or error}",
            fix="free disk space or choose another folder with --out; the journal has every row",
        ) from error


def read_rows(path: Path) -> tuple[list[Row], dict[str, str]]:
    """Read rows and their metadata, keys without the `nw.` prefix.

    Columns that this version does not know are left out: later versions may add some.

    Raises:
        StoreError: the file is missing, damaged, of another schema version, or no file of rows.
    """
    try:
        table = pq.read_table(path)
    except FileNotFoundError:
        raise StoreError(f"no rows at {path}", fix="name a run folder or its parquet") from None
    except (OSError, pa.ArrowException) as error:
        reason = str(error).splitlines()[0]
        raise StoreError(
            f"{path} is damaged: {reason}", fix="rebuild it from the journal"
        ) from None
    metadata = _metadata(table.schema)
    version = metadata.get("schema_version")
    if version != SCHEMA_VERSION:
        raise StoreError(
            f"{path} has row schema {version}, this nw-eval reads {SCHEMA_VERSION}",
            fix="use the version of nw-eval that wrote it",
        )
    held = table.schema.names
    if missing := [name for name in SCHEMA.names if name not in held and name not in _ADDED]:
        raise StoreError(f"{path} lacks the columns {', '.join(missing)}", fix="run again")
    try:
        return [from_dict(plain) for plain in _plain(table)], metadata
    except (ValueError, pa.ArrowException) as error:
        raise StoreError(f"{path} is damaged: {error}", fix="rebuild it from the journal") from None


def _plain(table: pa.Table) -> list[dict[str, Any]]:
    schema = pa.schema([field for field in SCHEMA if field.name in table.schema.names])
    return table.select(schema.names).cast(schema).to_pylist()


def _metadata(schema: pa.Schema) -> dict[str, str]:
    raw: Mapping[bytes, bytes] = schema.metadata or {}
    return {
        key.decode().removeprefix("nw."): value.decode()
        for key, value in raw.items()
        if key.startswith(b"nw.")
    }


def schema_text() -> str:
    """Return the schema as JSON lines of name and type: what a golden file is compared with."""
    return "".join(
        json.dumps({"name": field.name, "type": str(field.type), "nullable": field.nullable}) + "\n"
        for field in SCHEMA
    )
