"""What a drop is due to: what a policy sees, or what it does about it."""
