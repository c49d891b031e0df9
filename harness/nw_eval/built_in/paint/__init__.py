"""Materials: colour as a function of where one looks, procedural and seeded."""
