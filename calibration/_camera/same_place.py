"""Views of a board that did not move between them are one view."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from calibration._camera.view import BoardView
from rig import Notice, pluralize

_SAME_PX: Final = 1.0


def merge_same_places(views: Sequence[BoardView]) -> tuple[list[BoardView], list[Notice]]:
    """Average views whose corners are within a pixel of each other; return them with a notice."""
    groups: list[list[BoardView]] = []
    for view in views:
        group = next((group for group in groups if _same(group[0], view)), None)
        if group is None:
            groups.append([view])
        else:
            group.append(view)
    notices = []
    for group in groups:
        if len(group) > 1:
            text = (
                f"shows the calibration board at the same place as "
                f"{pluralize(len(group) - 1, 'other image')}: they count as one view"
            )
            notices.append(Notice("views-alike", text, group[0].name, "info"))
    return [_mean(group) for group in groups], notices


def _same(one: BoardView, other: BoardView) -> bool:
    ids, first, second = np.intersect1d(one.ids, other.ids, return_indices=True)
    if 2 * len(ids) < min(len(one.ids), len(other.ids)):
        return False
    apart = np.linalg.norm(one.corners_px[first] - other.corners_px[second], axis=1)
    return bool(np.median(apart) < _SAME_PX)


def _mean(group: Sequence[BoardView]) -> BoardView:
    if len(group) == 1:
        return group[0]
    ids = np.unique(np.concatenate([view.ids for view in group]))
    total, count = np.zeros((len(ids), 2)), np.zeros((len(ids), 1))
    for view in group:
        at = np.searchsorted(ids, view.ids)
        total[at] += view.corners_px
        count[at] += 1
    return replace(group[0], ids=ids, corners_px=total / count)
