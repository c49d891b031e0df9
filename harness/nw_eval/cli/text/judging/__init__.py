"""Text of what judges, and of what it is judged by."""
