"""How other programs show a trial's log: layouts for Foxglove and Rerun, and Rerun's recordings."""
