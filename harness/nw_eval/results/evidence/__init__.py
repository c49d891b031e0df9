"""A run's rows and logs under one digest, so that what was changed later is found and named."""
