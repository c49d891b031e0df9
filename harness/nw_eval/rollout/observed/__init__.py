"""What the policy saw, for the log."""
