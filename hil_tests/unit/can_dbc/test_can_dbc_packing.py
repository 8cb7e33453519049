"""Fields of every shape between a frame and its bits, against hand calculations."""

import enum
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from can_dbc import dbc_file
from can_dbc.agreement import FieldLayout, layouts
from can_dbc.binding import frame
from can_dbc.odometer import Doppler
from can_dbc.packing import EncodeError, invalid_values, packer, unpacker, value_table

ODD = """
VERSION ""
NS_ :
BS_:
BU_: VOBC TCU
BO_ 512 ODD: 5 TCU
 SG_ from_five : 0|4@1+ (1,0) [5|15] "" VOBC
 SG_ to_fourteen : 4|4@1+ (1,0) [0|14] "" VOBC
 SG_ ten_on : 8|8@1+ (1,10) [10|265] "" VOBC
 SG_ around_zero : 16|8@1- (1,0) [-100|100] "" VOBC
 SG_ all_of_a_byte : 24|8@1- (1,0) [-128|127] "" VOBC
 SG_ gear : 32|2@1+ (1,0) [0|2] "" VOBC
 SG_ slipping : 34|1@1+ (1,0) [0|1] "" VOBC
BA_DEF_ BO_ "GenMsgSendType" ENUM "cyclic","spontaneous";
BA_DEF_ BO_ "GenMsgCycleTime" INT 0 65535;
BA_DEF_DEF_ "GenMsgSendType" "cyclic";
BA_DEF_DEF_ "GenMsgCycleTime" 0;
BA_ "GenMsgCycleTime" BO_ 512 100;
VAL_ 512 gear 0 "NEUTRAL" 1 "FORWARD" 2 "REVERSE" ;
VAL_ 512 slipping 0 "FALSE" 1 "TRUE" ;
"""


class Gear(enum.IntEnum):
    NEUTRAL = 0
    FORWARD = 1
    REVERSE = 2


@dataclass(frozen=True, slots=True)
class Odd:
    from_five: int
    to_fourteen: int
    ten_on: int
    around_zero: int
    all_of_a_byte: int
    gear: Gear
    slipping: bool


@pytest.fixture
def odd(tmp_path: Path) -> type[Odd]:
    path = tmp_path / "odd.dbc"
    path.write_text(ODD, encoding="ascii")
    return frame(path, "ODD")(Odd)


def fields() -> dict[str, FieldLayout]:
    found = layouts(Odd, dbc_file.parse(ODD, "odd.dbc").message("ODD"))
    return {field.name: field for field in found}


# 5, 0, 17 (raw 7), -1, -128, REVERSE, true.
RAWS = {
    "from_five": 5,
    "to_fourteen": 0,
    "ten_on": 7,
    "around_zero": 0xFF,
    "all_of_a_byte": 0x80,
    "gear": 2,
    "slipping": 1,
}
STARTS = {
    "from_five": 0,
    "to_fourteen": 4,
    "ten_on": 8,
    "around_zero": 16,
    "all_of_a_byte": 24,
    "gear": 32,
    "slipping": 34,
}


def bits(**changed: int) -> int:
    return sum(raw << STARTS[name] for name, raw in (RAWS | changed).items())


def test_numbers_choices_and_booleans_convert_both_ways(odd: Any) -> None:
    value = Odd(5, 0, 17, -1, -128, Gear.REVERSE, slipping=True)

    assert packer(odd)(value) == bits()
    assert unpacker(odd)(bits()) == value
    heard: Any = unpacker(odd)(bits())
    assert type(heard.ten_on) is int


@pytest.mark.parametrize(
    ("name", "raw", "value"),
    [
        ("from_five", 4, None),
        ("from_five", 5, 5),
        ("from_five", 15, 15),
        ("to_fourteen", 0, 0),
        ("to_fourteen", 14, 14),
        ("to_fourteen", 15, None),
        ("ten_on", 0, 10),
        ("ten_on", 255, 265),
        ("around_zero", 100, 100),
        ("around_zero", 101, None),
        ("around_zero", 256 - 100, -100),
        ("around_zero", 256 - 101, None),
        ("all_of_a_byte", 127, 127),
        ("all_of_a_byte", 128, -128),
        ("gear", 2, Gear.REVERSE),
        ("gear", 3, None),
    ],
)
def test_a_raw_value_outside_its_range_or_table_gives_no_frame(
    odd: Any, name: str, raw: int, value: int | None
) -> None:
    heard = unpacker(odd)(bits(**{name: raw}))

    assert (None if heard is None else getattr(heard, name)) == value


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({}, ""),
        ({"to_fourteen": 14}, ""),
        ({"to_fourteen": 15}, "to_fourteen is raw 15, outside its range"),
        ({"from_five": 4}, "from_five is raw 4, outside its range"),
        ({"around_zero": 100}, ""),
        ({"around_zero": 101}, "around_zero is raw 101, outside its range"),
        ({"around_zero": 156}, ""),
        ({"around_zero": 155}, "around_zero is raw -101, outside its range"),
        ({"gear": 3}, "gear is 3, which its value table does not have"),
        (
            {"from_five": 0, "gear": 3},
            "from_five is raw 0, outside its range; gear is 3, which its value table does not have",
        ),
    ],
)
def test_exactly_the_invalid_values_are_named(changed: dict[str, int], words: str) -> None:
    assert invalid_values(tuple(fields().values()), bits(**changed)) == words


def test_a_bool_is_never_out_of_its_range() -> None:
    """Two bits that are neither TRUE nor FALSE count as FALSE."""
    switch = FieldLayout("switch", bool, 0, 2, False, 1.0, 0.0, 1.0, 2.0, 1, 2)

    assert [invalid_values((switch,), raw) for raw in range(4)] == [""] * 4


def test_a_value_table_has_one_entry_for_each_raw_value() -> None:
    assert value_table(fields()["gear"]) == (Gear.NEUTRAL, Gear.FORWARD, Gear.REVERSE, None)
    assert value_table(fields()["ten_on"]) is None


class Incomparable(float):
    """A number that refuses the comparison that a codec needs."""

    def __le__(self, _other: float) -> bool:
        raise ValueError


def test_a_number_that_cannot_be_compared_is_refused_with_its_frame() -> None:
    kind: Any = Doppler
    doppler = kind(Incomparable(1.5), 50.0, healthy=True)

    with pytest.raises(EncodeError, match=r"^DOPPLER: cannot be encoded: .*speed_mps=1.5"):
        packer(kind)(doppler)


@pytest.fixture
def nothing_made() -> Iterator[None]:
    """Clear the cached functions before and after the test."""
    for made in (packer, unpacker):
        made.cache_clear()
    yield
    for made in (packer, unpacker):
        made.cache_clear()
