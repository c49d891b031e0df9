"""A leaderboard: runs of policies and suites as pages that may be published."""
