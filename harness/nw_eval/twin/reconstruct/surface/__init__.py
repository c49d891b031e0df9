"""From depth maps to a surface: a truncated signed distance in sparse blocks, and its zero."""
