"""What trials' logs show of them: for pages, and for whoever else shows a run."""
