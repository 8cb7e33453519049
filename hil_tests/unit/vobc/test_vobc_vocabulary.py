"""The image of a cycle: each source keeps its own value with its own age."""

import dataclasses
import inspect
import math
import typing
from typing import Any

from vobc.vocabulary import CycleInput, Received, cycle_input

NOW_NS = 5_000_000_000
SOURCES = [
    name
    for name, parameter in inspect.signature(cycle_input).parameters.items()
    if "Received[" in str(parameter.annotation)
]
PLAIN: dict[str, Any] = {
    "now_ns": NOW_NS, "dt_s": 0.05, "overruns": 0, "tacho_samples": (), "tags": (),
    "tag_gap": False,
}  # fmt: skip


def test_every_field_but_the_plain_ones_is_a_source_and_its_age() -> None:
    fields = {field.name for field in dataclasses.fields(CycleInput)}

    assert len(SOURCES) == 14
    assert fields == {*PLAIN, *SOURCES, *(f"{name}_age_s" for name in SOURCES)}


def test_value_and_age_of_a_source_come_from_one_received() -> None:
    received: dict[str, Any] = {
        name: Received(f"value of {name}", NOW_NS - 1_000_000 * number)
        for number, name in enumerate(SOURCES)
    }

    image = cycle_input(**PLAIN, **received)

    for number, name in enumerate(SOURCES):
        assert getattr(image, name) == f"value of {name}"
        assert math.isclose(getattr(image, f"{name}_age_s"), 0.001 * number, abs_tol=1e-12)


def test_a_source_that_was_never_received_is_infinitely_old() -> None:
    nothing: dict[str, Any] = dict.fromkeys(SOURCES)

    image = cycle_input(**PLAIN, **nothing)

    assert image == CycleInput(now_ns=NOW_NS, dt_s=0.05)
    for name in SOURCES:
        assert getattr(image, name) is None
        assert getattr(image, f"{name}_age_s") == math.inf


def test_the_type_of_a_source_is_that_of_its_field() -> None:
    fields = typing.get_type_hints(CycleInput)
    parameters = typing.get_type_hints(cycle_input)

    for name in SOURCES:
        (received,) = [each for each in typing.get_args(parameters[name]) if each is not type(None)]
        assert set(typing.get_args(fields[name])) == {*typing.get_args(received), type(None)}
