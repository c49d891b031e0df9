"""The ledger: one line for each verdict that was given, and what they are worth together."""
