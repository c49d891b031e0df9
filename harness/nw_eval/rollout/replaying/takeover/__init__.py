"""A recorded trial that another policy takes over."""
