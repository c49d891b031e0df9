"""Sweeps as pages, pictures and rows."""
