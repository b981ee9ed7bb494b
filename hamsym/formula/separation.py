"""Separation of several formulas in one text at their commas."""

from __future__ import annotations


def separated(text: str) -> list[str]:
    """Split at the commas that are not inside parentheses; without blanks at the ends.

    Examples
    --------
    >>> separated("x, atan2(y, x), p_x > 0")
    ['x', 'atan2(y, x)', 'p_x > 0']
    """
    depth, start, parts = 0, 0, []
    for i, character in enumerate(text):
        depth += (character == "(") - (character == ")")
        if character == "," and depth == 0:
            parts.append(text[start:i])
            start = i + 1
    return [part.strip() for part in (*parts, text[start:])]
