"""What a drop is due to, in words and as a table."""
