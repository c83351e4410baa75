"""Matching of a tethered camera's images to shots."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from acquisition import DataError
from acquisition.imports.watch_match import Arrival, Match, Rule, follows_gap, match_shots
from acquisition.values.running_numbers import in_order, natural, running_number

LABELS = [f"L{led:02d}_E0" for led in range(36)]
BY_NUMBER = Rule()


def series(times: list[float], *, numbers: list[int] | None = None) -> list[Arrival]:
    count = numbers or list(range(1, len(times) + 1))
    return [Arrival(f"IMG_{n:04d}.CR2", t) for n, t in zip(count, times, strict=True)]


def numbered(*numbers: int) -> list[Arrival]:
    return series([0.0] * len(numbers), numbers=list(numbers))


def named(*names: str) -> list[Arrival]:
    return [Arrival(name, 0.0) for name in names]


def indices(arrivals: list[Arrival], rule: Rule = BY_NUMBER) -> list[int]:
    match = match_shots(arrivals, LABELS, {}, rule)
    return [match.shots.get(arrival.name, -1) for arrival in arrivals]


def as_they_arrive(arrivals: list[Arrival], rule: Rule = BY_NUMBER) -> tuple[list[int], list[str]]:
    """Match files one by one, each with a new start of the program; return shots and notices."""
    recorded: dict[str, int] = {}
    lines: list[str] = []
    for end in range(1, len(arrivals) + 1):
        present = {arrival.name: arrival for arrival in arrivals[:end]}
        order = in_order({name: arrival.written_s for name, arrival in present.items()})
        match = match_shots(
            [present[name] for name in order], LABELS, recorded, rule, earlier=set(recorded)
        )
        recorded |= match.shots
        lines += notices(match)
    return [recorded.get(arrival.name, -1) for arrival in arrivals], lines


def notices(match: Match) -> list[str]:
    noted = [str(notice) for listed in match.notices.values() for notice in listed]
    return noted + [str(notice) for notice in match.unused]


@pytest.mark.parametrize(
    ("arrivals", "expected"),
    [
        pytest.param(numbered(1, 2, 3, 4), [0, 1, 2, 3], id="all"),
        pytest.param(numbered(17, 18, 20, 23), [0, 1, 3, 6], id="missing"),
        pytest.param(numbered(1, 2, 4, 3, 5), [0, 1, 3, 2, 4], id="late"),
        pytest.param(numbered(9998, 9999, 1, 2), [0, 1, 2, 3], id="turnover"),
        pytest.param(numbered(9998, 1, 9999, 3), [0, 2, 1, 4], id="late-turnover"),
        pytest.param(numbered(850, 851, 1, 2), [0, 1, 2, 3], id="numbers-restart"),
        pytest.param(numbered(5, 6, 900, 901), [0, 1, 2, 3], id="numbers-jump"),
        pytest.param(named("a_1.tif", "a_2.tif", "b_7.tif", "b_8.tif"), [0, 1, 2, 3], id="series"),
        pytest.param(named("x.tif", "b.tif", "m.tif"), [0, 1, 2], id="no-numbers"),
        pytest.param(
            named(*(f"20240501_1230{s}.jpg" for s in ("01", "05", "59"))), [0, 1, 2], id="clocks"
        ),
        pytest.param(named("1714566601.png", "1714566605.png"), [0, 1], id="epoch"),
        pytest.param(
            named(*(f"owl 2024-05-01 12.30.0{i} ({i}).jpg" for i in (1, 2, 4))),
            [0, 1, 3],
            id="clocks-and-numbers",
        ),
    ],
)  # fmt: skip
def test_images_get_their_lights_by_number_or_in_order_of_arrival(
    arrivals: list[Arrival], expected: list[int]
) -> None:
    assert as_they_arrive(arrivals)[0] == expected


@given(st.permutations(range(12)), st.sets(st.integers(0, 11), max_size=6), st.integers(1, 9990))
def test_any_order_of_arrival_and_any_missing_images_give_the_same_lights(
    order: list[int], missing: set[int], first: int
) -> None:
    """The first image comes first; every other is late, early or missing, with restarts."""
    kept = [0, *(i for i in order if i and i not in missing)]
    rng = np.random.default_rng(first)
    times = rng.uniform(0, 1e4, len(kept)).tolist()  # pauses have no meaning
    arrivals = series(times, numbers=[first + i for i in kept])
    assert as_they_arrive(arrivals)[0] == kept


def test_a_missing_image_is_reported_once_and_not_while_its_file_is_incomplete() -> None:
    shots, lines = as_they_arrive(numbered(1, 2, 5, 6))
    assert shots == [0, 1, 4, 5]
    assert lines == ["2 images are missing by number between IMG_0002.CR2 and IMG_0005.CR2"]
    match = match_shots(numbered(1, 2, 5), LABELS, {}, waiting=["IMG_0003.CR2", "IMG_0004.CR2"])
    assert list(match.shots.values()) == [0, 1, 4]
    assert notices(match) == []
    # The first image of all is the lowest number in the folder, even if it is incomplete.
    assert match_shots(numbered(3), LABELS, {}, waiting=["IMG_0001.CR2"]).shots == {
        "IMG_0003.CR2": 2
    }


CONTRADICTIONS = {
    "duplicate": (
        [*numbered(1, 2), *named("IMG_0002.TIF")],
        [0, 1, -1],
        "IMG_0002.TIF: not recorded: its shot L01_E0 already has IMG_0002.CR2",
    ),
    "copy": (
        [*numbered(1, 2), *named("IMG_0002 (1).CR2")],
        [0, 1, 2],
        "IMG_0002 (1).CR2: does not continue the numbers of IMG_0002.CR2: it gets the next",
    ),
    "restart": (
        numbered(850, 851, 1),
        [0, 1, 2],
        "IMG_0001.CR2: is 849 numbers away from IMG_0850.CR2, more than there are shots: it",
    ),
    "beyond": (
        numbered(1, 20, 37),
        [0, 19, -1],
        "IMG_0037.CR2: no shot is left for this image, counted from IMG_0020.CR2",
    ),
}


@pytest.mark.parametrize(
    ("arrivals", "expected", "line"), CONTRADICTIONS.values(), ids=CONTRADICTIONS
)
def test_what_contradicts_the_numbers_is_reported(
    arrivals: list[Arrival], expected: list[int], line: str
) -> None:
    shots, lines = as_they_arrive(arrivals)
    assert shots == expected
    assert any(text.startswith(line) for text in lines), lines


def test_a_number_below_the_first_is_an_error_because_the_lights_are_shifted() -> None:
    with pytest.raises(DataError, match=r"IMG_0001\.CR2: .* below that of IMG_0003\.CR2, which was "
                       r"recorded as L00_E0: .* are shifted"):  # fmt: skip
        as_they_arrive(numbered(3, 4, 1))


def test_files_named_after_their_shots_are_passed_over() -> None:
    arrivals = [*named("a.tif", "b.tif"), *numbered(1, 2)]
    match = match_shots(arrivals[:2], LABELS, {}, named={"L00.tif": 0, "L02.tif": 2})
    assert match.unused[0].where == "a.tif"
    assert match_shots(arrivals[:2], LABELS, {}, named={"L01.tif": 1}).shots == {
        "a.tif": 0,
        "b.tif": 2,
    }


@pytest.mark.parametrize(
    ("times", "numbers", "expected"),
    [
        pytest.param([0, 2.1, 4, 6.1, 7.9, 12], None, [0, 1, 2, 3, 4, 6], id="one-missing"),
        pytest.param([0, 4, 6], None, [0, 2, 3], id="from-the-first-on"),
        pytest.param([0, 2, 8, 10, 12, 14], None, [0, 1, 4, 5, 6, 7], id="two-missing"),
        pytest.param([0, 2, 4, 6, 8, 10, 12.9], None, [0, 1, 2, 3, 4, 5, 6], id="only-slow"),
        # A delayed or overwritten file: the files after it are too early for a gap.
        pytest.param([0, 2, 4, 6, 8, 11.8, 12], None, list(range(7)), id="delayed"),
        pytest.param(
            [0, 2, 4, 6, 8, 10, 18, 18.2, 18.4, 18.6, 20], None, list(range(11)), id="delayed-burst"
        ),
        pytest.param([0, 2, 4, 6, 8, 10, 14.2, 14, 16], None, list(range(9)), id="overtaken"),
        # The numbers have no gap although an image is missing: the camera was not triggered.
        pytest.param([0, 2, 4, 8, 10, 12], [1, 2, 3, 4, 5, 6], [0, 1, 2, 4, 5, 6], id="no-trigger"),
        # A number is missing but the times have no gap: an earlier test shot was deleted.
        pytest.param([0, 2, 4, 6, 8, 10], [1, 2, 3, 5, 6, 7], [0, 1, 2, 3, 4, 5], id="deleted"),
        pytest.param([0, 2, 400, 402], None, [0, 1, 2, 3], id="longer-than-all"),
    ],
)
def test_a_stated_interval_shows_gaps_in_time(
    times: list[float], numbers: list[int] | None, expected: list[int]
) -> None:
    assert indices(series(times, numbers=numbers), Rule(interval_s=2.0)) == expected
    unnumbered = [Arrival(f"{'abcdefghijk'[i]}.tif", t) for i, t in enumerate(times)]
    assert indices(unnumbered, Rule(interval_s=2.0)) == expected


def test_without_a_stated_interval_pauses_have_no_meaning() -> None:
    assert indices(series([0, 2, 4, 400, 401, 9000])) == [0, 1, 2, 3, 4, 5]


def test_the_message_about_a_gap_names_its_neighbours() -> None:
    match = match_shots(series([0, 2, 6]), LABELS, {}, Rule(interval_s=2.0))
    assert notices(match) == [
        "1 image is missing between IMG_0002.CR2 and IMG_0003.CR2: they are 4.0 s apart, the "
        "interval is 2.0 s"
    ]
    match = match_shots(series([0, 2], numbers=[1, 4]), LABELS, {}, Rule(interval_s=2.0))
    assert notices(match) == [
        "2 images are missing by number between IMG_0001.CR2 and IMG_0004.CR2, but not by time"
    ]


def test_the_time_between_two_watches_has_no_meaning_and_is_reported() -> None:
    shots, lines = as_they_arrive(series([0, 2, 60, 62]), Rule(interval_s=2.0))
    assert shots == [0, 1, 2, 3]
    assert lines == [
        "IMG_0003.CR2: the time since IMG_0002.CR2 does not count, because the watch was restarted"
    ]


def test_times_of_the_camera_are_preferred_to_those_of_the_files() -> None:
    """Files copied at an even pace, with one shot missing that only the camera's times show."""
    taken = [0, 5, 10, 20, 25, 30, 35]
    arrivals = [Arrival(f"{i}.NEF", 1000.0 + i, float(t)) for i, t in enumerate(taken)]
    assert indices(arrivals, Rule(interval_s=5.0)) == [0, 1, 2, 4, 5, 6, 7]
    # Too fast for a clock with whole seconds: times of files count if both have the same span.
    quick = [Arrival(f"{i}.NEF", 1000 + 1.4 * t, float(int(1.4 * t)))
             for i, t in enumerate([0, 1, 2, 4, 5, 6])]  # fmt: skip
    assert indices(quick, Rule(interval_s=1.4)) == [0, 1, 2, 4, 5, 6]
    copied = [Arrival(a.name, i * 8.0, a.taken_s) for i, a in enumerate(quick)]
    assert indices(copied, Rule(interval_s=1.4)) == [0, 1, 2, 3, 4, 5]


def test_the_last_image_follows_a_gap_in_time() -> None:
    assert follows_gap(series([0, 2, 6]), 2.0)
    assert not follows_gap(series([0, 2, 4]), 2.0)
    assert not follows_gap(series([0]), 2.0)


def test_without_gaps_only_the_order_of_arrival_counts() -> None:
    shots, lines = as_they_arrive(numbered(5, 9, 7, 20), Rule(gaps=False))
    assert shots == [0, 1, 2, 3]
    assert lines == ["IMG_0007.CR2: has a lower number than IMG_0009.CR2: it gets the next shot"]


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("IMG_0012.CR2", ("img_#", 12)),
        ("12.png", ("#", 12)),
        ("owl_3_left.tif", ("owl_#_left", 3)),
        ("top.png", None),
        ("20240501_123001.jpg", None),
        ("2024-05-01T12:30:01.250.png", None),
        ("PXL_20240501_123001123.jpg", None),
        ("20240501_0003.NEF", ("20240501_#", 3)),
        ("IMG_0007_20240501_123001.jpg", ("img_#_", 7)),
        ("1714566601000.png", None),
    ],
)
def test_running_numbers(name: str, expected: tuple[str, int] | None) -> None:
    found = running_number(name)
    assert (found and found[:2]) == expected


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


def test_series_are_in_order_of_their_first_files() -> None:
    """Names without a running number are series of their own; those with a clock are one."""
    written = {"b.png": 3.0, "a.png": 4.0, "DSC_2.png": 2.0, "DSC_1.png": 9.0, "c.png": 1.0}
    assert in_order(written) == ["c.png", "DSC_1.png", "DSC_2.png", "b.png", "a.png"]
    clocks = {"20240501_123005.png": 1.0, "20240501_123001.png": 2.0}
    assert in_order(clocks) == ["20240501_123001.png", "20240501_123005.png"]
