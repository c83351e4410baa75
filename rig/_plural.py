"""Counts with their nouns, for messages."""

from __future__ import annotations


def pluralize(count: int, singular: str, plural: str | None = None) -> str:
    """Return a count and its noun in the right number: ``1 frame``, ``3 frames``.

    Parameters
    ----------
    count
        The number.
    singular
        The words for 1, which may include the verb: ``frame is``.
    plural
        The words for other numbers. Default: ``singular`` with an s.

    Examples
    --------
    >>> from rig import pluralize
    >>> pluralize(1, "frame"), pluralize(3, "frame is", "frames are")
    ('1 frame', '3 frames are')
    """
    return f"{count} {singular if count == 1 else plural or f'{singular}s'}"
