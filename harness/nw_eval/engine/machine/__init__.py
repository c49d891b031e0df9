"""What the engine asks of the machine and of the terminal."""
