"""Validation errors of pydantic as one line."""

from typing import Annotated

import pytest
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from rig.messages import validation_message


class Lamp(BaseModel):
    model_config = ConfigDict(extra="forbid")

    led: int
    shade: "Lamp | None" = None
    spare: tuple[int, ...] = ()
    watts: Annotated[tuple[Annotated[float, Field(gt=0)], ...], Field(min_length=1)] = (1.0,)

    @model_validator(mode="after")
    def _spare_differs(self):
        if self.led in self.spare:
            raise ValueError("a lamp is\nits own spare")
        return self


MESSAGES = {
    "unknown": ({"led": 1, "x": 2}, "unknown option 'x'; known are led, shade, spare, watts"),
    "unknown below": ({"led": 1, "shade": {"led": 2, "x": 2}}, "unknown option 'shade.x'"),
    "missing": ({}, "the option 'led' is missing"),
    "value": (
        {"led": "tall"},
        (
            "option 'led': Input should be a valid integer, unable to parse string as an integer, "
            "not 'tall'"
        ),
    ),
    "nested": (
        {"led": 1, "spare": [0, 0.5]},
        (
            "option 'spare.1': Input should be a valid integer, got a number with a fractional "
            "part, not 0.5"
        ),
    ),
    "an invalid item, without which the list is too short": (
        {"led": 1, "watts": [0]},
        "option 'watts.0': Input should be greater than 0, not 0",
    ),
    "a list that is too short": (
        {"led": 1, "watts": []},
        "option 'watts': Tuple should have at least 1 item after validation, not 0",
    ),
    "long value": (
        {"led": "x" * 99},
        "option 'led': Input should be a valid integer, unable to parse string as an integer",
    ),
    "the model itself": ({"led": 1, "spare": (1,)}, "a lamp is its own spare"),
    "several complaints, the unknown names first": (
        {"x": 1, "y": 2},
        (
            "unknown option 'x'; known are led, shade, spare, watts; unknown option 'y'; "
            "the option 'led' is missing"
        ),
    ),
    "three at most": (
        {"led": 1, "watts": [0, 1, 0, 0, 0, 0]},
        (
            "option 'watts.0': Input should be greater than 0, not 0; "
            "option 'watts.2': Input should be greater than 0, not 0; "
            "option 'watts.3': Input should be greater than 0, not 0 (and 2 more)"
        ),
    ),
}


@pytest.mark.parametrize(("values", "said"), MESSAGES.values(), ids=MESSAGES)
def test_validation_message(values, said):
    with pytest.raises(ValidationError) as caught:
        Lamp.model_validate(values)
    assert validation_message(caught.value, noun="option", known=Lamp.model_fields) == said
