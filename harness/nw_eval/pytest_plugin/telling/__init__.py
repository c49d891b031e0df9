"""What a session of pytest shows of suites."""
