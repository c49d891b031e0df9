"""report.html: one file that holds all it shows, and asks no network for anything."""
