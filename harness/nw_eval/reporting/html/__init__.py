"""Pages of one file each, which hold all they show and ask no network for anything."""
