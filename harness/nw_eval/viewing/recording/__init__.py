"""A trial's log for Rerun: a layout for its own reading of the log, or a recording of our own."""
