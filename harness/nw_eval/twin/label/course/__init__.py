"""A course over the ground: what clicks meet, heights along the way, and what legs make of it."""
