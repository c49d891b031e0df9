"""Scene folders, read and written for labelling."""
