"""What makes a surface a place to walk in: one piece, flat where it is flat, of few faces."""
