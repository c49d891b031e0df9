"""The columns that have been published.

`python tests/gate/results/record_columns.py` records those that were added at the end of
row_schema.jsonl. It refuses while a published one has changed.
"""

from __future__ import annotations

import json
import sys
from itertools import zip_longest
from pathlib import Path

from nw_gate.results.parquet import SCHEMA

RECORD = Path(__file__).with_name("row_schema.jsonl")


def schema_text() -> str:
    """Return the schema as JSON lines of name and type."""
    return "".join(
        json.dumps({"name": field.name, "type": str(field.type), "nullable": field.nullable}) + "\n"
        for field in SCHEMA
    )


def recorded(published: str, now: str) -> str:
    """Return the record once columns were added.

    Raises:
        ValueError: a published column has changed, moved or gone.
    """
    for old, new in zip_longest(published.splitlines(), now.splitlines()):
        if old is not None and old != new:
            raise ValueError(f"published as {old}, now {new or 'gone'}: readers rely on it")
    return now


if __name__ == "__main__":
    try:
        RECORD.write_text(recorded(RECORD.read_text("utf-8"), schema_text()), "utf-8")
    except ValueError as error:
        sys.exit(str(error))
