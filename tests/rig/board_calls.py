"""Every command of a board, and the check that an error is one line."""

from rig.board import Step

VERBS = {
    "ON": lambda board: board.on(9, 5000),
    "OFF": lambda board: board.off(),
    "LEVEL": lambda board: board.level(9, 4095),
    "FLASH": lambda board: board.flash(9, 1000, 2000),
    "STEP": lambda board: board.load([Step(9, 1000, 2000, 0)]),
    "RUN": lambda board: board.run(1),
    "DID": lambda board: board.step_report(0),
    "STATUS": lambda board: board.status(),
}


def one_line(error, *parts):
    text = str(error.value)
    assert "\n" not in text
    for part in parts:
        assert part in text
