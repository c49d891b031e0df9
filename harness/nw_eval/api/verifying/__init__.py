"""Verifying a run: whether its files are as they were, and its trials give the same bits again."""
