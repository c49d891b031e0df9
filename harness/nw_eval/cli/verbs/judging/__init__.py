"""Verbs that judge rows, and plan or keep what they are judged by."""
