"""What becomes of each trial: attempts, the row of the last one, and whether there is another."""
