"""Baselines: banks are saved, listed, shown, checked and compared."""
