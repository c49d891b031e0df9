"""What the messages of each topic hold."""
