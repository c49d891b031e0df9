"""A recorded trial run again from its log."""
