"""What a column is, is said once, at its field; what has been published stays."""

from __future__ import annotations

import importlib.util
import json
import subprocess
import sys
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Annotated

import pytest

from nw_gate.results.column import Column, columns_of
from nw_gate.results.parquet import SCHEMA
from nw_gate.results.row import COLUMNS, MEASURED, OF_THE_PLAN, Row


def _record():
    path = Path(__file__).with_name("record_columns.py")
    spec = importlib.util.spec_from_file_location("record_columns", path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


record = _record()
PUBLISHED = record.RECORD.read_text("utf-8")
_HINT = "if columns were added, run `python tests/gate/results/record_columns.py` and commit that"


def test_the_schema_is_the_one_that_readers_elsewhere_rely_on():
    """Columns may be added at the end of the record; none may change or go."""
    assert record.schema_text() == PUBLISHED, _HINT


def test_the_record_takes_up_what_is_added_and_nothing_else():
    added = PUBLISHED + json.dumps({"name": "mood", "type": "string", "nullable": False}) + "\n"
    assert record.recorded(PUBLISHED, added) == added
    changed = PUBLISHED.replace('"contact_s", "type": "double"', '"contact_s", "type": "int32"')
    with pytest.raises(ValueError, match=r'"contact_s".*, now .*"int32"'):
        record.recorded(PUBLISHED, changed)
    shorter = "".join(PUBLISHED.splitlines(keepends=True)[:-1])
    with pytest.raises(ValueError, match=rf'"{[*COLUMNS][-1]}".*, now gone'):
        record.recorded(PUBLISHED, shorter)


def test_every_field_of_a_row_is_a_column_and_says_what_it_holds():
    assert SCHEMA.names == list(COLUMNS) == [field.name for field in fields(Row)]
    assert all(len(column.about) > 5 for column in COLUMNS.values())
    assert {name: SCHEMA.field(name).metadata[b"about"].decode() for name in COLUMNS} == {
        name: column.about for name, column in COLUMNS.items()
    }


def test_wall_times_are_measured_and_no_simulated_time_is():
    times = {name for name in COLUMNS if name.endswith("_s")}
    assert times - MEASURED == {"sim_s", "contact_s"}
    assert not MEASURED & OF_THE_PLAN


def test_a_field_that_says_nothing_or_came_later_without_a_default_is_not_a_column():
    @dataclass
    class Silent:
        steps: int

    @dataclass
    class Late:
        steps: Annotated[int, Column("control steps done", added=True)]

    with pytest.raises(TypeError, match="steps of Silent does not describe its column"):
        columns_of(Silent)
    with pytest.raises(TypeError, match="steps of Late was added later and needs a default"):
        columns_of(Late)


def test_the_columns_are_known_without_arrow():
    code = "import sys, nw_gate.results.row; print('pyarrow' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "False\n"
