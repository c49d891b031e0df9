"""Results of trials that have run before, kept in the user's cache folder."""
