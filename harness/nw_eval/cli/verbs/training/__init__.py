"""The verbs that make policies: they call `nw_eval.learn`."""
