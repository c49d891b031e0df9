"""Running, and judging what ran: a request becomes a plan, a plan a run, a run a report."""
