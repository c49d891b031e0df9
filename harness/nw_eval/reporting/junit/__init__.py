"""A judged run as JUnit XML, for servers that show tests."""

from __future__ import annotations

from nw_eval.reporting.junit.document import junit_of_error, junit_xml

__all__ = ["junit_of_error", "junit_xml"]
