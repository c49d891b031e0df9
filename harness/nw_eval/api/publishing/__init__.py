"""Where a judged run is shown besides its report."""
