"""What is wrong along a trail, with its number, its threshold, and what to do."""
