"""The gate: rows in, verdict out. Imports no simulation."""
