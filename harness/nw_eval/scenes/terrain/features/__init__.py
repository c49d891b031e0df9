"""What of a mesh a height field alone would get wrong."""
