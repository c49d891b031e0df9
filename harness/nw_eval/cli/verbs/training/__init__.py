"""`nw-eval train`: programs that make policies, a module for each."""
