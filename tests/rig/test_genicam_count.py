"""Block ids: assignment of frames to triggers for devices that count in different ways."""

import pytest

from rig.genicam.frame_count import BlockCount


def places(*starts):
    """Return the places for starts given as number of triggers and block ids that arrived."""
    count = BlockCount()
    found = []
    for triggers, blocks in starts:
        count.started()
        found.append([count.place(block, triggers) for block in blocks])
    return found


@pytest.mark.parametrize(
    ("starts", "expected"),
    [
        pytest.param([(1, [0])], [[0]], id="from 0"),
        pytest.param([(1, [1])], [[0]], id="from 1"),
        pytest.param([(3, [0, 1, 2])], [[0, 1, 2]], id="several from 0"),
        pytest.param([(3, [1, 2, 3])], [[0, 1, 2]], id="several from 1"),
        pytest.param([(3, [2, 3])], [[1, 2]], id="the first of several lost"),
        pytest.param([(1, [0]), (3, [1, 2])], [[0], [1, 2]], id="from 0 is known, the first lost"),
        pytest.param([(1, [1]), (3, [2, 3])], [[0], [1, 2]], id="from 1 is known, the first lost"),
        pytest.param([(2, [0, 1]), (2, [0, 1])], [[0, 1], [0, 1]], id="restarts"),
        pytest.param([(1, [7]), (1, [8]), (2, [9, 10])], [[0], [0], [0, 1]], id="never restarts"),
        pytest.param([(1, [1]), (1, [5])], [[0], [0]], id="continues after unseen frames"),
        pytest.param([(1, [0]), (9, list(range(9))), (1, [3])], [[0], list(range(9)), [3]],
                     id="neither restarts nor continues"),
        pytest.param([(3, [5000, 5001, 5002])], [[0, 1, 2]], id="continues from another program"),
        pytest.param([(3, [0, 1, 2]), (3, [7, 8, 9])], [[0, 1, 2], [0, 1, 2]],
                     id="continues after a loss, beyond the number of triggers"),
        pytest.param([(3, [0, 2])], [[0, 2]], id="a gap"),
        pytest.param([(3, [0, 1, 1])], [[0, 1, None]], id="repeated"),
        pytest.param([(3, [0, 2, 1])], [[0, 2, None]], id="backwards"),
        pytest.param([(1, [1]), (2, [0])], [[0], [None]], id="before the first"),
        pytest.param([(1, [65534]), (1, [65535]), (1, [1]), (1, [2])], [[0], [0], [0], [0]],
                     id="16 bits overflow between acquisitions"),
        pytest.param([(1, [65535]), (1, [1])], [[0], [0]], id="overflow before it is learned"),
        pytest.param([(5, [65533, 65534, 2])], [[0, 1, 4]], id="lost at an overflow to 1"),
        pytest.param([(1, [65534]), (4, [65535, 0, 1, 2])], [[0], [0, 1, 2, 3]],
                     id="overflow to 0"),
        pytest.param([(1, [2**32 - 1]), (2, [0, 1])], [[0], [0, 1]], id="32 bits"),
        pytest.param([(1, [2**64 - 1]), (2, [1, 2])], [[0], [0, 1]], id="64 bits"),
        pytest.param([(4, [65534, 65535, 1, 65535])], [[0, 1, 2, None]], id="late after one"),
        pytest.param([(3, [65535, 1, 1])], [[0, 1, None]], id="repeated after one"),
        pytest.param([(1, [1]), (65_000, range(1, 65_001)), (3, [2, 3])],
                     [[0], list(range(65_000)), [1, 2]], id="restarts near the end of its range"),
    ],
)  # fmt: skip
def test_frames_are_assigned_to_triggers(starts, expected):
    assert places(*starts) == expected
