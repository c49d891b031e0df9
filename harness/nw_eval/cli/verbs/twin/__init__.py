"""`nw-eval twin`: photographs to a place, all at once or stage by stage."""
