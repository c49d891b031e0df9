"""The 64 synthetic places as data, and how they are painted and baked."""
