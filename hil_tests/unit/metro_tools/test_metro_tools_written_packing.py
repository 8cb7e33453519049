"""Generated packing functions of the compiled copy behave like those created at start."""

import math
import sys
from collections.abc import Callable
from dataclasses import fields, replace
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import pytest

from can_dbc import diagnostics, packing
from can_dbc.agreement import payload_bytes
from can_dbc.binding import binding_of, kinds
from can_dbc.odometer import Doppler, Tacho
from can_dbc.packing import EncodeError, packer, unpacker
from metro_tools.compiled import FRAMES
from metro_tools.written_inits import with_bound_frames
from metro_tools.written_packing import written

SHOTS = 400


@pytest.fixture(scope="module")
def functions() -> dict[tuple[str, Any], Callable[[Any], Any]]:
    modules = [name.removesuffix(".py").replace("/", ".") for name in FRAMES]
    space: dict[str, Any] = {"__name__": __name__}
    exec(written(modules), space)  # noqa: S102
    found: dict[tuple[str, Any], Callable[[Any], Any]] = space["FUNCTIONS"]
    return found


def test_each_frame_of_the_modules_has_both(
    functions: dict[tuple[str, Any], Callable[[Any], Any]],
) -> None:
    written_kinds = {kind for _, kind in functions}

    assert written_kinds == {kind for kind in kinds() if kind.__module__ != diagnostics.__name__}
    assert len(functions) == 2 * len(written_kinds)


def test_any_bits_decode_equally_and_encode_back(
    functions: dict[tuple[str, Any], Callable[[Any], Any]],
) -> None:
    draw = np.random.default_rng(1)
    for kind in {kind for _, kind in functions}:
        length = payload_bytes(binding_of(kind).message)
        for _ in range(SHOTS):
            bits = int.from_bytes(draw.bytes(length), "little")
            wanted = unpacker(kind)(bits)
            assert functions["unpack", kind](bits) == wanted
            if wanted is not None:
                assert functions["pack", kind](wanted) == packer(kind)(wanted)


def test_numbers_beyond_their_range_and_between_two_steps_are_packed_the_same(
    functions: dict[tuple[str, Any], Callable[[Any], Any]],
) -> None:
    draw = np.random.default_rng(2)
    for kind in {kind for _, kind in functions}:
        frame: Any = unpacker(kind)(packer(kind)(_least(kind)))
        for field in binding_of(kind).fields:
            if field.kind is not float:
                continue
            low, high = field.minimum, field.maximum
            inside = draw.uniform(low, high, 50).tolist()
            halves = [low + field.scale * (step + 0.5) for step in range(6)]
            for value in (-math.inf, low, high, math.inf, *inside, *halves):
                changed = replace(frame, **{field.name: value})
                assert functions["pack", kind](changed) == packer(kind)(changed)


def _least(kind: Any) -> Any:
    """A frame with the least value of each field."""
    values = {}
    for field in binding_of(kind).fields:
        if field.kind in (int, float):
            values[field.name] = field.kind(field.minimum)
        else:
            choices: Any = (False, True) if field.kind is bool else field.kind
            values[field.name] = next(iter(choices))
    return kind(**values)


def test_a_nan_is_refused_with_the_same_message(
    functions: dict[tuple[str, Any], Callable[[Any], Any]],
) -> None:
    wrong = Doppler(speed_mps=math.nan, quality_percent=1.0, healthy=True)

    for pack in (functions["pack", Doppler], packer(Doppler)):
        with pytest.raises(EncodeError, match=r"^DOPPLER: speed_mps: nan is not a number$"):
            pack(wrong)


def test_generated_functions_are_used_where_they_exist(monkeypatch: pytest.MonkeyPatch) -> None:
    def pack(frame: object) -> int:
        return 7

    module = SimpleNamespace(FUNCTIONS={("pack", Doppler): pack})
    monkeypatch.setitem(sys.modules, packing.WRITTEN, module)

    assert packer.__wrapped__(Doppler) is pack
    assert packer.__wrapped__(Tacho) is not pack
    assert unpacker.__wrapped__(Doppler)(0) is not None


BOUND = '''\
"""Frames."""

from dataclasses import dataclass

from can_dbc.binding import frame


@frame("odometer.dbc", "DOPPLER")
@dataclass(frozen=True, slots=True)
class Radar:
    speed_mps: float
    quality_percent: float
    healthy: bool


LAST = 1
'''


def test_a_frame_bound_after_its_class_definition_is_handled_equally() -> None:
    text = with_bound_frames(BOUND)
    assert len(text.splitlines()) == len(BOUND.splitlines())
    module = ModuleType("radar")
    sys.modules["radar"] = module
    try:
        exec(text, module.__dict__)  # noqa: S102
        bound = binding_of(module.Radar)
    finally:
        del sys.modules["radar"]

    assert "@frame" not in text
    assert [field.name for field in fields(module.Radar)] == [each.name for each in bound.fields]
    assert bound.message.name == "DOPPLER"
