"""Figures of studies: no screen is needed, and colours differ for everybody."""
