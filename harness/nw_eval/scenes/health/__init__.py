"""What is wrong with a place, said before a robot finds out."""
