"""Results: one row per trial, the journal that grows during a run, and the run's folder."""
