"""Looking at trials in a browser: a wing of its own, which nothing below knows."""
