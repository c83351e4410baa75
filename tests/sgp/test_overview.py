"""The sheet with the overview pictures."""

import pytest

from acquisition import read_image
from sgp._overview import Panel, write_overview


@pytest.mark.parametrize(
    ("count", "columns", "rows"),
    [(8, 4, 2), (9, 3, 3), (10, 5, 2), (11, 4, 3), (12, 4, 3)],
)
def test_few_places_stay_empty(tmp_path, count, columns, rows):
    panels = [Panel(str(index), lambda axes: axes.axis("off")) for index in range(count)]
    write_overview(tmp_path / "sheet.png", "", panels)
    assert read_image(tmp_path / "sheet.png").shape[:2] == (370 * rows, 400 * columns)
