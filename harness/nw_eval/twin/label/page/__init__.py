"""The label page: a `Labelling` in the browser, by viser."""

from nw_eval.twin.label.page.label_page import LabelPage

__all__ = ["LabelPage"]
