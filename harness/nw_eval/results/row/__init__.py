"""One trial's result: what a run is made of, and all that gate and report read."""

from nw_eval.results.row.column import Column
from nw_eval.results.row.row import (
    COLUMNS,
    MEASURED,
    OF_THE_PLAN,
    Row,
    from_dict,
    from_dicts,
    rows_digest,
    to_dict,
)

__all__ = [
    "COLUMNS",
    "MEASURED",
    "OF_THE_PLAN",
    "Column",
    "Row",
    "from_dict",
    "from_dicts",
    "rows_digest",
    "to_dict",
]
