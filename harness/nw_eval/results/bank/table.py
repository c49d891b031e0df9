"""The starts of a bank as an Arrow table."""

from __future__ import annotations

import pyarrow as pa

from nw_eval.results.bank.check import SHARED
from nw_eval.results.bank.start import SavedBank
from nw_eval.results.columns import SCHEMA

_PANEL, _TRAJECTORY = "panel", "trajectory"

BANK_SCHEMA = pa.schema(
    [
        pa.field(_PANEL, pa.int32(), nullable=False),
        *(pa.field(name, SCHEMA.field(name).type, nullable=False) for name in SHARED),
        pa.field(_TRAJECTORY, pa.binary(8), nullable=False),
    ]
)
"""The number of the panel in the manifest, columns of a row, and the trajectory's bytes."""


def bank_table(bank: SavedBank) -> pa.Table:
    """Return the starts of all panels, one after another."""
    lines = [
        {
            _PANEL: number,
            **{name: getattr(start, name) for name in SHARED},
            _TRAJECTORY: bytes.fromhex(start.trajectory),
        }
        for number, panel in enumerate(bank.panels)
        for start in panel.starts
    ]
    return pa.Table.from_pylist(lines, schema=BANK_SCHEMA)
