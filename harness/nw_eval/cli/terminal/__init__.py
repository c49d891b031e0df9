"""What a verb shares with a terminal: streams, signals, progress, and the last word."""
