"""The loops of a reconstruction, compiled. None of them knows of files."""
