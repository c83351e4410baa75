"""The contact sheet of a session: the order of its frames."""

from types import SimpleNamespace

from sgp.sessions.session_sheet import in_order


def test_lights_come_first_in_the_order_of_their_leds():
    def frame(role, led=None, bracket=0):
        return SimpleNamespace(role=role, led=led, bracket=bracket)

    taken = [
        frame("ambient"),
        frame("dark", bracket=1),
        frame("dark"),
        frame("light", 10),
        frame("flat", 2),
        frame("light", 2, 1),
        frame("light", 9),
        frame("flat"),
        frame("light", 2),
    ]
    shown = [(one.role, one.led, one.bracket) for one in in_order(taken)]
    assert shown == [
        ("light", 2, 0),
        ("light", 2, 1),
        ("light", 9, 0),
        ("light", 10, 0),
        ("flat", None, 0),
        ("flat", 2, 0),
        ("dark", None, 0),
        ("dark", None, 1),
        ("ambient", None, 0),
    ]
