"""Notices about cameras that store each exposure twice, as camera RAW and as another image."""

from __future__ import annotations

from rig import Notice, pluralize


def raw_preferred_notice(count: int | None, where: str) -> Notice:
    """Return the notice that camera RAW is used and the other images are not.

    ``count`` is their number, None if more may follow.
    """
    text = "the camera stores RAW and other images of the same exposures: the RAW files are used"
    if count is not None:
        others = pluralize(count, "other image is", "other images are")
        text += f", the {others} not"
    return Notice("raw-preferred", text, where, "info")
