"""Texts that describe a recording for people."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Labels:
    """Texts that describe a recording for people; a program reads none of them.

    Parameters
    ----------
    operator
        Name of the operator.
    object_name
        Name of the object.
    place
        Place of the recording.
    notes
        Free text.
    rights
        Holder of the rights, and the licence.
    """

    operator: str = ""
    object_name: str = ""
    place: str = ""
    notes: str = ""
    rights: str = ""
