"""From when on a failure was not to be averted: by letting a baseline take over."""
