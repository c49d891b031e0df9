"""One trial, from seed to result, and its log."""
