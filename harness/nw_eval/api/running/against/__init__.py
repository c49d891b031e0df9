"""Running against a bank: which one, what comes before the first trial, when to end."""
