"""Pure functions on arrays: numbers in, small frozen results out. Knows no suites and no rows."""
