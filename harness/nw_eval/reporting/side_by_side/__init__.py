"""Policies side by side, as tables, as a page and as a picture."""
