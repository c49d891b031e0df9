"""Untrusted files, opened in a process that may do nothing else."""
