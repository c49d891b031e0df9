"""Videos of trials that run again."""
