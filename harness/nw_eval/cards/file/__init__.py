"""The file that a card is read from."""
