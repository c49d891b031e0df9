"""A card drafted from what a checkpoint tells."""
