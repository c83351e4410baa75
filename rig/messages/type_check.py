"""Arguments of a wrong type are refused in plain words."""

from __future__ import annotations

from numbers import Integral


def check_type(name: str, value: object, kind: type, hint: str = "") -> None:
    """Refuse an argument that is not of a type.

    Parameters
    ----------
    name
        Name of the parameter.
    value
        The argument.
    kind
        The required type.
    hint
        How to make such a value from what callers usually have instead.

    Raises
    ------
    TypeError
        If it is not; the message names the parameter, both types and the hint.

    Examples
    --------
    >>> from rig import check_type
    >>> check_type("name", 3, str)
    Traceback (most recent call last):
        ...
    TypeError: name must be a str, not a int
    """
    if not isinstance(value, kind):
        given, needed = type(value).__name__, kind.__name__
        raise TypeError(f"{name} must be a {needed}, not a {given}{hint and ': ' + hint}")


def check_led(led: object) -> None:
    """Refuse an LED number that is not an integer, for example True or 3.0.

    Raises
    ------
    TypeError
        If it is neither an integer nor None.

    Examples
    --------
    >>> from rig.messages import check_led
    >>> check_led(7)
    >>> check_led(True)
    Traceback (most recent call last):
        ...
    TypeError: an LED number must be an int, not True
    """
    if led is not None and (isinstance(led, bool) or not isinstance(led, Integral)):
        raise TypeError(f"an LED number must be an int, not {led!r}")
