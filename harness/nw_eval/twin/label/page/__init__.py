"""The label page: a `Labelling` in the browser, by viser."""

from nw_eval.twin.label.page.label_page import LabelPage
from nw_eval.viewing.browser import check_server

__all__ = ["LabelPage", "check_server"]
