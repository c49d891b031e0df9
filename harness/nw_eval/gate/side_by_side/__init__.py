"""Policies side by side: runs and banks in, ranks and where they part out."""
