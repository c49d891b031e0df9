"""What a page draws, as numbers: its templates only lay them out."""
