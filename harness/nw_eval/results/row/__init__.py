"""One trial's result: what a run is made of, and all that gate and report read."""

from nw_eval.results.row.column import Column
from nw_eval.results.row.row import (
    COLUMNS,
    MEASURED,
    OF_THE_PLAN,
    VIEW_RATE,
    Row,
    by_column,
    from_dict,
    from_dicts,
    self_contradiction,
    to_dict,
)
from nw_eval.results.row.texts import Result, RowTexts, digest_of_results, rows_digest, texts_of

__all__ = [
    "COLUMNS",
    "MEASURED",
    "OF_THE_PLAN",
    "VIEW_RATE",
    "Column",
    "Result",
    "Row",
    "RowTexts",
    "by_column",
    "digest_of_results",
    "from_dict",
    "from_dicts",
    "rows_digest",
    "self_contradiction",
    "texts_of",
    "to_dict",
]
