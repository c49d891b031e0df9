"""What a teacher trains on: random courses by level, and the training scenes."""
