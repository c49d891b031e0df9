"""The gate against a baseline: a run's rows and a baseline in, what they show of the drop out."""
