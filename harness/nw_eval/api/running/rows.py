"""A run's rows as a table, for whoever wants to reckon with them."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import pandas as pd


def read_rows(run: str | Path) -> pd.DataFrame:
    """Return the rows of a run that count: a line for each trial of its plan that has a result.

    Args:
        run: the run's folder; it may go on, or have been interrupted.

    Returns:
        A column for each field of `Row`, sorted by trial. `trial_id` and the start that it names
        are the same for every policy of a suite. `success` is missing where a trial ended in an
        error, which says nothing about the policy.

    Raises:
        UsageError: it is no run's folder.
        StoreError: its rows are damaged.
    """
    import pandas as pd

    from nw_eval.api.running.saved_run import saved_suite, saved_trials
    from nw_eval.results.ended import read_trials
    from nw_eval.results.provenance import read_run_info
    from nw_eval.results.row import Row, to_dict
    from nw_eval.results.run_folder import open_run_folder

    folder = open_run_folder(Path(run))
    info = read_run_info(folder.run_json)
    found = read_trials(folder, info, saved_trials(info, saved_suite(info)))
    rows = sorted(found.rows, key=lambda row: row.trial_id)
    return pd.DataFrame([to_dict(row) for row in rows], columns=list(Row.__dataclass_fields__))
