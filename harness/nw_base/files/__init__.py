"""Files: the cache, what lies inside a folder, YAML with line numbers, and what is shipped."""
