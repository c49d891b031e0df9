"""Parts of a run, put together in one folder that is what the run would be without parts."""
