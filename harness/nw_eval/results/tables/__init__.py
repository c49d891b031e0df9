"""Tables as files: sealed Parquet, read by a process of its own whoever has written it."""
