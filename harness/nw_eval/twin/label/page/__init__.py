"""The label page: a `Labelling` in the browser, by viser."""
