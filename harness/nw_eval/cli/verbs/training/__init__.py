"""The verbs of learning: `nw-eval train`, a module for each program, and `nw-eval study`."""
