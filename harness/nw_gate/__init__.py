"""The gate: rows in, verdict out. It needs no simulator.

    judge(read_evaluation("new.parquet"), read_evaluation("old.parquet")).word

What is named here judges episodes of any simulator. `baseline` and `absolute` judge rows of nw-eval
by a baseline that is known start by start; `limits` finds the hardest scene that a policy still
completes; `stats` has the tests, `scores` what is measured, `results` how rows, runs and baselines
are kept.
"""

from nw_base.public import public_names

_RENAMED = {"Limits": "JudgeSettings"}
"""Earlier names, which are understood for one release."""

__getattr__, __dir__, __all__ = public_names(__name__, __file__, _RENAMED)  # pyright: ignore[reportUnsupportedDunderAll]
