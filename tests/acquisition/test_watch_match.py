"""Matching of a tethered camera's images to shots."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from acquisition._import.watch_match import Arrival, in_order, match_shots, natural, pace_of


def series(times: list[float], *, numbers: list[int] | None = None) -> list[Arrival]:
    count = numbers or list(range(1, len(times) + 1))
    return [Arrival(f"IMG_{n:04d}.CR2", t) for n, t in zip(count, times, strict=True)]


def matched(arrivals: list[Arrival], count: int = 36, interval_s: float | None = None) -> list[int]:
    match = match_shots(arrivals, count, {}, pace_of(arrivals, interval_s))
    return [match.shots.get(arrival.name, -1) for arrival in arrivals]


@pytest.mark.parametrize(
    ("times", "numbers", "expected"),
    [
        pytest.param([0, 2, 4, 6, 8, 10], None, [0, 1, 2, 3, 4, 5], id="steady"),
        pytest.param([0, 2.1, 4, 6.1, 7.9, 12], None, [0, 1, 2, 3, 4, 6], id="one-missing"),
        pytest.param([0, 2, 8, 10, 12, 14], None, [0, 1, 4, 5, 6, 7], id="two-missing"),
        pytest.param([0, 4, 6, 8, 10, 12], None, [0, 2, 3, 4, 5, 6], id="second-missing"),
        pytest.param([0, 2, 4, 6, 8, 10, 14.4], None, [0, 1, 2, 3, 4, 5, 7], id="late-gap"),
        pytest.param([0, 2, 4, 6, 8, 10, 12.9], None, [0, 1, 2, 3, 4, 5, 6], id="only-slow"),
        # A delayed or overwritten file: the files after it are too early for a gap.
        pytest.param([0, 2, 4, 6, 8, 11.8, 12], None, list(range(7)), id="delayed"),
        pytest.param(
            [0, 2, 4, 6, 8, 10, 18, 18.2, 18.4, 18.6, 20], None, list(range(11)), id="delayed-burst"
        ),
        pytest.param([0, 2, 4, 6, 8, 10, 14.2, 14, 16], None, list(range(9)), id="overtaken"),
        pytest.param(
            [0, 2, 4, 6, 8, 10, 14, 16, 18, 20],
            None,
            [0, 1, 2, 3, 4, 5, 7, 8, 9, 10],
            id="gap-in-the-middle",
        ),
        pytest.param([0, 5, 6, 19, 21, 40], None, [0, 1, 2, 3, 4, 5], id="by-hand"),
        pytest.param([0, 9, 1, 30, 2, 50], [1, 2, 4, 5, 6, 8], [0, 1, 3, 4, 5, 7], id="numbers"),
        pytest.param([0, 0.1, 0.2, 0.4, 0.5, 0.6], None, [0, 1, 2, 3, 4, 5], id="copied"),
        pytest.param([0, 2, 4], None, [0, 1, 2], id="too-few"),
        # The numbers have no gap although an image is missing: the camera was not triggered.
        pytest.param([0, 2, 4, 8, 10, 12], [1, 2, 3, 4, 5, 6], [0, 1, 2, 4, 5, 6], id="no-trigger"),
        # A number is missing but the times have no gap: an earlier test shot was deleted.
        pytest.param([0, 2, 4, 6, 8, 10], [1, 2, 3, 5, 6, 7], [0, 1, 2, 3, 4, 5], id="deleted"),
    ],
)
def test_order_time_and_numbers(
    times: list[float], numbers: list[int] | None, expected: list[int]
) -> None:
    assert matched(series(times, numbers=numbers)) == expected


def test_with_a_known_interval_gaps_are_found_from_the_first_image_on() -> None:
    assert matched(series([0, 4, 6]), interval_s=2.0) == [0, 2, 3]
    assert matched(series([0, 4, 6])) == [0, 1, 2]


def test_the_message_about_a_gap_names_its_neighbours() -> None:
    arrivals = series([0, 2, 4, 6, 8, 12])
    (gap,) = match_shots(arrivals, 36, {}, pace_of(arrivals)).gaps
    assert gap == (
        "1 image is missing between IMG_0005.CR2 and IMG_0006.CR2: they are 4.0 s apart, the pace "
        "is 2.0 s"
    )
    by_number = series([0, 1, 9, 11, 30], numbers=[1, 2, 5, 6, 7])
    (gap,) = match_shots(by_number, 36, {}, pace_of(by_number)).gaps
    assert gap == "2 images are missing by number between IMG_0002.CR2 and IMG_0005.CR2"


def test_times_of_the_camera_are_preferred_to_those_of_the_files() -> None:
    """Files copied at an even pace, with one shot missing that only the camera's times show."""
    taken = [0, 5, 10, 20, 25, 30, 35]
    arrivals = [Arrival(f"{i}.NEF", 1000.0 + i, float(t)) for i, t in enumerate(taken)]
    assert matched(arrivals) == [0, 1, 2, 4, 5, 6, 7]
    # Too fast for a clock with whole seconds: times of files count if both have the same span.
    quick = [Arrival(f"{i}.NEF", 1000 + 1.4 * t, float(int(1.4 * t))) for i, t in
             enumerate([0, 1, 2, 4, 5, 6])]  # fmt: skip
    assert matched(quick) == [0, 1, 2, 4, 5, 6]
    copied = [replace_written(arrival, i * 3.0) for i, arrival in enumerate(quick)]
    assert matched(copied) == [0, 1, 2, 3, 4, 5]


def replace_written(arrival: Arrival, written_s: float) -> Arrival:
    return Arrival(arrival.name, written_s, arrival.taken_s)


def test_without_gaps_only_the_order_counts() -> None:
    arrivals = series([0, 2, 4, 6, 8, 12])
    match = match_shots(arrivals, 36, {}, pace_of(arrivals), gaps=False)
    assert list(match.shots.values()) == [0, 1, 2, 3, 4, 5]


def test_images_for_which_no_shot_is_left_are_named() -> None:
    match = match_shots(series([0, 2, 4, 6]), 3, {}, None)
    assert match.unused == ("IMG_0004.CR2",)
    assert list(match.shots.values()) == [0, 1, 2]


def test_recorded_files_keep_their_shots_and_a_late_file_gets_the_missing_one() -> None:
    arrivals = series([0, 2, 4, 8, 10, 12])
    assigned = match_shots(arrivals, 36, {}, pace_of(arrivals)).shots
    assert 3 not in assigned.values()
    late = [*arrivals[:3], Arrival("IMG_0003b.CR2", 6.0), *arrivals[3:]]
    again = match_shots(late, 36, assigned, pace_of(late))
    assert again.shots == {**assigned, "IMG_0003b.CR2": 3}
    assert again.gaps == ()


def test_names_are_sorted_in_natural_order() -> None:
    names = ["IMG_10.CR2", "IMG_9.CR2", "img_1.CR2", "a.CR2", "7.CR2"]
    expected = ["7.CR2", "a.CR2", "img_1.CR2", "IMG_9.CR2", "IMG_10.CR2"]
    assert sorted(names, key=natural) == expected


def test_running_numbers_that_restart_after_9999() -> None:
    names = ["IMG_9998.CR2", "IMG_9999.CR2", "IMG_0001.CR2", "IMG_0002.CR2"]
    assert in_order({name: 2.0 * i for i, name in enumerate(names)}) == names
    # If the files were written in reverse order, the low numbers are the earlier ones.
    assert in_order({name: -2.0 * i for i, name in enumerate(names)}) == sorted(names)
    assert in_order({}) == []


@given(
    st.integers(7, 40),
    st.floats(1.0, 60.0),
    st.integers(0, 2**32 - 1),
    st.data(),
)
def test_if_any_single_shots_are_missing_the_others_keep_their_lights(
    count: int, pace_s: float, seed: int, data: st.DataObject
) -> None:
    rng = np.random.default_rng(seed)
    missing = data.draw(st.sets(st.integers(1, count - 2), max_size=max(0, (count - 6) // 4)))
    # No pace can be found if two in a row or most of the first images are missing.
    kept = [i for i in range(count) if i not in missing or i - 1 in missing]
    if sum(b - a > 1 for a, b in pairwise(kept[:6])) > 2:
        return
    times = [pace_s * (i + 0.1 * rng.uniform(-1, 1)) for i in kept]
    assert matched(series(times), count) == kept
    # Matched one by one as they appear, files never change their shot.
    assigned: dict[str, int] = {}
    for end in range(6, len(kept) + 1):
        arrivals = series(times[:end])
        assigned |= match_shots(arrivals, count, assigned, pace_of(arrivals)).shots
    assert list(assigned.values()) == kept
