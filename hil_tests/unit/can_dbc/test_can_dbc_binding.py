"""Every possible contradiction between a DBC file and a frame class is named."""

import enum
import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import pytest

from can_dbc import binding, dbc_file
from can_dbc.binding import BindingError, bind, frame
from can_dbc.brake import BrakeCommand
from can_dbc.diagnostics import EMERGENCIES
from can_dbc.nodes import Node

GOOD = """
VERSION ""
NS_ :
BS_:
BU_: VOBC TCU
BO_ 256 GEAR_CMD: 7 VOBC
 SG_ force_n : 0|16@1+ (10,0) [0|400000] "N" TCU
 SG_ accel_mps2 : 16|8@1- (0.05,0) [-6|6] "m/s2" TCU
 SG_ gear : 24|2@1+ (1,0) [0|2] "" TCU
 SG_ enabled : 26|2@1+ (1,0) [0|3] "" TCU
 SG_ steps : 28|4@1+ (1,0) [0|15] "" TCU
 SG_ alive_counter : 32|8@1+ (1,0) [0|255] "" TCU
 SG_ crc16 : 40|16@1+ (1,0) [0|65535] "" TCU
BO_ 257 GEAR_CMD_INV: 7 VOBC
 SG_ force_n : 0|16@1+ (-10,655350) [0|400000] "N" TCU
 SG_ accel_mps2 : 16|8@1- (-0.05,-0.05) [-6|6] "m/s2" TCU
 SG_ gear : 24|2@1+ (1,0) [1|3] "" TCU
 SG_ enabled : 26|2@1+ (1,0) [0|3] "" TCU
 SG_ steps : 28|4@1+ (-1,15) [0|15] "" TCU
 SG_ alive_counter : 32|8@1+ (1,0) [0|255] "" TCU
 SG_ crc16 : 40|16@1+ (1,0) [0|65535] "" TCU
BO_ 512 GEAR_INFO: 2 TCU
 SG_ slipping : 0|1@1+ (1,0) [0|1] "" VOBC
 SG_ heat_ratio : 8|8@1+ (0.004,0) [0|1] "1" VOBC
BA_DEF_ BO_ "GenMsgSendType" ENUM "cyclic","spontaneous";
BA_DEF_ BO_ "GenMsgCycleTime" INT 0 65535;
BA_DEF_ BO_ "TimeoutMs" INT 0 65535;
BA_DEF_ BO_ "Protection" ENUM "NONE","SAFETY","VITAL";
BA_DEF_ BO_ "SafetyDataId" INT 0 65535;
BA_DEF_ SG_ "GenSigStartValue" INT 0 65535;
BA_DEF_DEF_ "GenMsgSendType" "cyclic";
BA_DEF_DEF_ "GenMsgCycleTime" 0;
BA_DEF_DEF_ "TimeoutMs" 0;
BA_DEF_DEF_ "Protection" "NONE";
BA_DEF_DEF_ "SafetyDataId" 0;
BA_DEF_DEF_ "GenSigStartValue" 0;
BA_ "GenMsgCycleTime" BO_ 256 50;
BA_ "TimeoutMs" BO_ 256 200;
BA_ "Protection" BO_ 256 2;
BA_ "SafetyDataId" BO_ 256 4711;
BA_ "GenSigStartValue" SG_ 256 enabled 1;
BA_ "GenMsgCycleTime" BO_ 257 50;
BA_ "TimeoutMs" BO_ 257 200;
BA_ "Protection" BO_ 257 2;
BA_ "SafetyDataId" BO_ 257 4712;
BA_ "GenSigStartValue" SG_ 257 force_n 65535;
BA_ "GenSigStartValue" SG_ 257 accel_mps2 -1;
BA_ "GenSigStartValue" SG_ 257 gear 3;
BA_ "GenSigStartValue" SG_ 257 enabled 2;
BA_ "GenSigStartValue" SG_ 257 steps 15;
BA_ "GenMsgCycleTime" BO_ 512 100;
VAL_ 256 gear 0 "NEUTRAL" 1 "FORWARD" 2 "REVERSE" ;
VAL_ 256 enabled 1 "FALSE" 2 "TRUE" ;
VAL_ 257 gear 3 "NEUTRAL" 2 "FORWARD" 1 "REVERSE" ;
VAL_ 257 enabled 2 "FALSE" 1 "TRUE" ;
VAL_ 512 slipping 0 "FALSE" 1 "TRUE" ;
"""


class Gear(enum.IntEnum):
    NEUTRAL = 0
    FORWARD = 1
    REVERSE = 2


@dataclass(frozen=True, slots=True)
class GearCommand:
    force_n: float
    accel_mps2: float
    gear: Gear
    enabled: bool
    steps: int


@dataclass(frozen=True, slots=True)
class GearInfo:
    slipping: bool
    heat_ratio: float


def bound(text: str, kind: type = GearCommand, message: str = "GEAR_CMD") -> binding.Binding:
    return bind(kind, dbc_file.parse(text, "bad.dbc"), message)


def complaint(text: str, kind: type = GearCommand, message: str = "GEAR_CMD") -> str:
    with pytest.raises(BindingError) as caught:
        bound(text, kind, message)
    return str(caught.value)


def changed(old: str, new: str) -> str:
    assert GOOD.count(old) == 1, old
    return GOOD.replace(old, new)


def test_an_agreeing_class_is_bound() -> None:
    command = bound(GOOD)

    assert command.kind is GearCommand
    assert command.twin is not None
    assert command.twin.name == "GEAR_CMD_INV"
    assert (command.period_s, command.timeout_s) == (0.05, 0.2)
    assert [field.name for field in command.fields] == [
        *("force_n", "accel_mps2", "gear", "enabled", "steps")
    ]
    assert (command.fields[1].raw_minimum, command.fields[1].raw_maximum) == (-120, 120)


def test_the_default_timeout_is_three_periods() -> None:
    info = bound(GOOD, GearInfo, "GEAR_INFO")

    assert info.timeout_s == 0.3
    assert info.twin is None


MESSAGE_FAULTS = {
    "sender": ("BO_ 256 GEAR_CMD: 7 VOBC", "BO_ 256 GEAR_CMD: 7 Vector__XXX", "no single sender"),
    "float": ('BA_DEF_ BO_ "TimeoutMs"',
              'SIG_VALTYPE_ 256 force_n : 1;\nBA_DEF_ BO_ "TimeoutMs"',
              "force_n: is a floating-point signal"),
    "no period": ('BA_ "GenMsgCycleTime" BO_ 256 50;', "", "set GenMsgCycleTime"),
    "short timeout": ('"TimeoutMs" BO_ 256 200', '"TimeoutMs" BO_ 256 149', "set 150 or more"),
    "spontaneous": ('BA_ "TimeoutMs" BO_ 256 200;',
                    'BA_ "GenMsgSendType" BO_ 256 1;', "is protected but not cyclic"),
    "period on occasion": ('BA_ "TimeoutMs" BO_ 256 200;',
                           'BA_ "GenMsgSendType" BO_ 256 1;', "has a period or a timeout"),
    "no data id": ('"SafetyDataId" BO_ 256 4711', '"SafetyDataId" BO_ 256 0',
                   "without a SafetyDataId"),
    "data id unprotected": ('BA_ "Protection" BO_ 256 2;', "", "SafetyDataId in an unprotected"),
    "trailer unprotected": ('BA_ "Protection" BO_ 256 2;', "",
                            "alive_counter: in an unprotected message"),
    "bad protection": ('"Protection" BO_ 256 2', '"Protection" BO_ 256 7', "Protection is 7"),
    "twin but not vital": ('"Protection" BO_ 256 2', '"Protection" BO_ 256 1',
                           "set Protection to VITAL or remove"),
    "vital without twin": ("GEAR_CMD_INV", "GEAR_OTHER",
                           "VITAL without a twin; add GEAR_CMD_INV"),
    "unused bits": ("steps : 28|4@1+ (1,0) [0|15]", "steps : 28|3@1+ (1,0) [0|7]",
                    "leaves 1 bits unused"),
}  # fmt: skip


@pytest.mark.parametrize("name", MESSAGE_FAULTS)
def test_a_fault_of_the_message_is_named(name: str) -> None:
    old, new, words = MESSAGE_FAULTS[name]

    text = complaint(changed(old, new))

    assert words in text
    assert "GEAR_CMD" in text
    assert "bad.dbc" in text or name == "bad protection"


COUNTER = ' SG_ alive_counter : 32|8@1+ (1,0) [0|255] "" TCU\n'
CRC = ' SG_ crc16 : 40|16@1+ (1,0) [0|65535] "" TCU\n'


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        (COUNTER, "", "alive_counter: missing in a protected message; add it at 32|8@1+ (1,0)"),
        (CRC, "", "crc16: missing in a protected message; add it at 40|16@1+ (1,0)"),
        (CRC, CRC.replace("40|16", "40|15"), "crc16: must lie in the last three bytes"),
        (CRC, CRC.replace("(1,0)", "(2,0)"), "crc16: must lie in the last three bytes"),
        (CRC, CRC.replace("(1,0)", "(1,1)"), "crc16: must lie in the last three bytes"),
        (CRC, CRC.replace("@1+", "@1-"), "crc16: must lie in the last three bytes"),
        (COUNTER, COUNTER.replace("32|8", "32|7"), "alive_counter: must lie in the last three"),
        (
            COUNTER + CRC,
            COUNTER.replace("32|8", "48|8") + CRC.replace("40|16", "32|16"),
            "unscaled: 32|8@1+",
        ),
    ],
)
def test_the_trailer_must_be_the_last_three_bytes(old: str, new: str, words: str) -> None:
    text = complaint(GOOD.replace(old, new, 1))

    assert words in text


def test_an_identifier_of_29_bits_is_refused() -> None:
    text = complaint(GOOD.replace(" 256 ", f" {0x80000000 + 256} "))

    assert "bad.dbc: GEAR_CMD: has a 29-bit identifier" in text


def test_a_message_longer_than_classic_can_is_refused() -> None:
    text = complaint(changed("GEAR_INFO: 2", "GEAR_INFO: 9"), GearInfo, "GEAR_INFO")

    assert "bad.dbc: GEAR_INFO: is 9 bytes long; classic CAN carries 8" in text


FIELD_FAULTS = {
    "no signal": (' SG_ steps : 28|4@1+ (1,0) [0|15] "" TCU\n', "",
                  "steps: a field of GearCommand without a signal; add it"),
    "misspelt signal": ("SG_ steps : 28|4@1+ (1,0)", "SG_ stepps : 28|4@1+ (1,0)",
                        "steps: a field of GearCommand without a signal; rename signal stepps"),
    "no field": ("SG_ steps : 28|4@1+ (1,0)", "SG_ stairs : 28|4@1+ (1,0)",
                 "stairs: a signal without a field; add it to GearCommand"),
    "motorola": ("SG_ force_n : 0|16@1+ (10,0)", "SG_ force_n : 7|16@0+ (10,0)",
                 "force_n: is in Motorola order"),
    "multiplexed": ("SG_ steps : 28|4@1+ (1,0)", "SG_ steps M : 28|4@1+ (1,0)",
                    "steps: is multiplexed"),
    "unit": ('(10,0) [0|400000] "N"', '(10,0) [0|400000] "kN"',
             "force_n: unit is 'kN' but the name says 'N'"),
    "no unit": ('(10,0) [0|400000] "N"', '(10,0) [0|400000] ""',
                "force_n: unit is '' but the name says 'N'"),
    "unit of int": ('28|4@1+ (1,0) [0|15] ""', '28|4@1+ (1,0) [0|15] "m"',
                    "steps: has unit 'm' but GearCommand.steps is an int"),
    "fraction": ("28|4@1+ (1,0) [0|15]", "28|4@1+ (0.5,0) [0|7]",
                 "steps: scaling (0.5,0) is no count"),
    "twos": ("28|4@1+ (1,0) [0|15]", "28|4@1+ (2,0) [0|30]", "steps: scaling (2,0) is no count"),
    "fractional offset": ("28|4@1+ (1,0) [0|15]", "28|4@1+ (1,0.5) [1|15]",
                          "steps: scaling (1,0.5) is no count"),
    "no range": ("(10,0) [0|400000]", "(10,0) [0|0]", "force_n: has no range"),
    "range wrong way": ("(10,0) [0|400000]", "(10,0) [9|1]", "force_n: has no range"),
    "range too high": ("(10,0) [0|400000]", "(10,0) [0|655360]",
                       "force_n: range end 655360.0 does not fit 16 bits"),
    "range too low": ("(10,0) [0|400000]", "(10,0) [-10|400000]",
                      "force_n: range end -10.0 does not fit 16 bits"),
    "signed range too high": ("8@1- (0.05,0) [-6|6]", "8@1- (0.05,0) [-6|6.4]",
                              "accel_mps2: range end 6.4 does not fit 8 bits"),
    "signed range too low": ("8@1- (0.05,0) [-6|6]", "8@1- (0.05,0) [-6.45|6]",
                             "accel_mps2: range end -6.45 does not fit 8 bits"),
    "int range": ("28|4@1+ (1,0) [0|15]", "28|4@1+ (1,0) [0|16]",
                  "steps: range end 16.0 does not fit 4 bits"),
    "no scale": ("(10,0) [0|400000]", "(0,0) [0|400000]", "force_n: scale is 0"),
    "backwards": ("(10,0) [0|400000]", "(-10,0) [0|400000]", "force_n: scale is -10"),
    "bool width": ("enabled : 26|2@1+ (1,0) [0|3] \"\" TCU\n SG_ steps : 28|4@1+ (1,0)",
                   "enabled : 26|1@1+ (1,0) [0|1] \"\" TCU\n SG_ steps : 28|4@1+ (1,0)",
                   "enabled: is 1 bits wide; a bool in this message takes 2"),
    "bool table": ('VAL_ 256 enabled 1 "FALSE" 2 "TRUE"', 'VAL_ 256 enabled 1 "TRUE" 2 "FALSE"',
                   "enabled: value table says 1 is TRUE, GearCommand.enabled says FALSE"),
    "no bool table": ('VAL_ 256 enabled 1 "FALSE" 2 "TRUE" ;', "",
                      "enabled: value table says 1 is nothing"),
    "enum value": ('VAL_ 256 gear 0 "NEUTRAL" 1', 'VAL_ 256 gear 0 "NEUTRAL" 3',
                   "gear: value table says 1 is nothing, GearCommand.gear says FORWARD"),
    "enum name": ('"NEUTRAL" 1 "FORWARD"', '"NEUTRAL" 1 "AHEAD"',
                  "gear: value table says 1 is AHEAD, GearCommand.gear says FORWARD"),
    "enum extra": ('2 "REVERSE" ;\nVAL_ 256 enabled', '2 "REVERSE" 3 "PARK" ;\nVAL_ 256 enabled',
                   "gear: value table says 3 is PARK, GearCommand.gear says nothing"),
    "enum missing": ('VAL_ 256 gear 0 "NEUTRAL" 1 "FORWARD" 2 "REVERSE" ;',
                     'VAL_ 256 gear 0 "NEUTRAL" 1 "FORWARD" ;',
                     "gear: value table says 2 is nothing, GearCommand.gear says REVERSE"),
    "enum scaled": ("gear : 24|2@1+ (1,0) [0|2]", "gear : 24|2@1+ (2,0) [0|2]",
                    "gear: GearCommand.gear is a choice; its signal must be unsigned, (1,0)"),
    "enum offset": ("gear : 24|2@1+ (1,0) [0|2]", "gear : 24|2@1+ (1,1) [0|2]",
                    "gear: GearCommand.gear is a choice"),
    "enum signed": ("gear : 24|2@1+ (1,0) [0|2]", "gear : 24|2@1- (1,0) [0|2]",
                    "gear: 2 bits cannot hold every value of GearCommand.gear"),
    "enum unit": ('gear : 24|2@1+ (1,0) [0|2] ""', 'gear : 24|2@1+ (1,0) [0|2] "m"',
                  "without a unit"),
    "float table": ('VAL_ 256 gear', 'VAL_ 256 force_n 0 "NONE" ;\nVAL_ 256 gear',
                    "force_n: has a value table but GearCommand.force_n is a float"),
    "int table": ('VAL_ 256 gear', 'VAL_ 256 steps 0 "NONE" ;\nVAL_ 256 gear',
                  "steps: has a value table but GearCommand.steps is an int"),
}  # fmt: skip


@pytest.mark.parametrize("name", FIELD_FAULTS)
def test_a_fault_of_a_signal_is_named_with_file_message_and_signal(name: str) -> None:
    old, new, words = FIELD_FAULTS[name]

    text = complaint(changed(old, new))

    assert any(line.startswith(f"bad.dbc: GEAR_CMD: {words}") for line in text.splitlines()) or (
        words in text and "bad.dbc: GEAR_CMD: gear: " in text
    )


TWIN_FAULTS = {
    "identifier": ("BO_ 257 GEAR_CMD_INV", "BO_ 300 GEAR_CMD_INV",
                   "identifier is 300; the twin needs 257"),
    "length": ("BO_ 257 GEAR_CMD_INV: 7", "BO_ 257 GEAR_CMD_INV: 8",
               "length is 8; the twin needs 7"),
    "sender": ("GEAR_CMD_INV: 7 VOBC", "GEAR_CMD_INV: 7 TCU", "senders is ['TCU']"),
    "period": ('CycleTime" BO_ 257 50', 'CycleTime" BO_ 257 60', "GenMsgCycleTime is 60"),
    "timeout": ('"TimeoutMs" BO_ 257 200', '"TimeoutMs" BO_ 257 201', "TimeoutMs is 201"),
    "protection": ('"Protection" BO_ 257 2', '"Protection" BO_ 257 1', "Protection is SAFETY"),
    "data id": ('"SafetyDataId" BO_ 257 4712', '"SafetyDataId" BO_ 257 0', "SafetyDataId of its"),
    "send type": ('BA_ "Protection" BO_ 257 2;',
                  'BA_ "Protection" BO_ 257 2;\nBA_ "GenMsgSendType" BO_ 257 1;',
                  "GenMsgSendType is spontaneous"),
    "scale": ("(-10,655350)", "(10,655350)", "force_n: scale is 10.0; the twin needs -10.0"),
    "offset": ("(-10,655350)", "(-10,655360)",
               "force_n: offset is 655360.0; the twin needs 655350.0"),
    "signed offset": ("(-0.05,-0.05)", "(-0.05,0)",
                      "accel_mps2: offset is 0.0; the twin needs -0.05"),
    "range": ("(-10,655350) [0|400000]", "(-10,655350) [0|400010]", "force_n: range is"),
    "choice range": ("gear : 24|2@1+ (1,0) [1|3]", "gear : 24|2@1+ (1,0) [0|2]", "gear: range is"),
    "unit": ('(-10,655350) [0|400000] "N"', '(-10,655350) [0|400000] "kN"', "unit is kN"),
    "start bit": ('gear : 24|2@1+ (1,0) [1|3] "" TCU\n SG_ enabled : 26|2',
                  'gear : 26|2@1+ (1,0) [1|3] "" TCU\n SG_ enabled : 24|2',
                  "gear: start bit is 26; the twin needs 24"),
    "width": ("steps : 28|4@1+ (-1,15)", "steps : 28|3@1+ (-1,15)", "steps: length is 3"),
    "sign": ("force_n : 0|16@1+ (-10,655350)", "force_n : 0|16@1- (-10,655350)",
             "force_n: signed is True"),
    "table": ('VAL_ 257 enabled 2 "FALSE" 1 "TRUE"', 'VAL_ 257 enabled 1 "FALSE" 2 "TRUE"',
              "enabled: value table is"),
    "start value": ("SG_ 257 enabled 2", "SG_ 257 enabled 1", "enabled: start value is 1"),
    "missing signal": (' SG_ steps : 28|4@1+ (-1,15) [0|15] "" TCU\n', "",
                       "steps: only in one of the twins"),
    "more": ("BO_ 512 GEAR_INFO", ' SG_ spare : 56|1@1+ (1,0) [0|1] "" TCU\nBO_ 512 GEAR_INFO',
             "spare: only in one of the twins"),
}  # fmt: skip


@pytest.mark.parametrize("name", TWIN_FAULTS)
def test_a_twin_that_is_not_congruent_is_named(name: str) -> None:
    old, new, words = TWIN_FAULTS[name]
    text = changed(old, new)
    if name == "identifier":
        text = text.replace(" 257 ", " 300 ")
    if name == "more":
        text = text.replace("GEAR_CMD_INV: 7", "GEAR_CMD_INV: 8")

    found = complaint(text)

    assert any(
        line.startswith("bad.dbc: GEAR_CMD: GEAR_CMD_INV: ") and words in line
        for line in found.splitlines()
    )


@pytest.mark.parametrize("attribute", ["GenMsgCycleTime", "TimeoutMs"])
def test_an_event_driven_message_may_have_neither_period_nor_timeout(attribute: str) -> None:
    text = changed(
        'BA_ "GenMsgCycleTime" BO_ 512 100;',
        f'BA_ "{attribute}" BO_ 512 100;\nBA_ "GenMsgSendType" BO_ 512 1;',
    )

    found = complaint(text, GearInfo, "GEAR_INFO")

    assert "bad.dbc: GEAR_INFO: is not cyclic but has a period or a timeout" in found


def test_an_unprotected_bool_takes_one_bit() -> None:
    text = changed("slipping : 0|1@1+ (1,0) [0|1]", "slipping : 0|2@1+ (1,0) [0|3]")

    found = complaint(text, GearInfo, "GEAR_INFO")

    assert "bad.dbc: GEAR_INFO: slipping: is 2 bits wide; a bool in this message takes 1" in found


def test_an_enumeration_too_wide_for_a_table_is_refused() -> None:
    @dataclass(frozen=True, slots=True)
    class WideInfo:
        slipping: Gear
        heat_ratio: float

    text = changed("slipping : 0|1@1+ (1,0) [0|1]", "slipping : 16|11@1+ (1,0) [0|2]").replace(
        "GEAR_INFO: 2", "GEAR_INFO: 4"
    )

    found = complaint(text, WideInfo, "GEAR_INFO")

    assert "slipping: is 11 bits wide; an enumeration takes at most 10" in found


def test_a_float_needs_a_unit() -> None:
    @dataclass(frozen=True, slots=True)
    class Unitless:
        slipping: bool
        heat: float

    text = changed("SG_ heat_ratio", "SG_ heat")

    found = complaint(text, Unitless, "GEAR_INFO")

    assert "heat: Unitless.heat is a float whose name ends in no known unit" in found


def test_a_field_of_another_type_is_refused() -> None:
    @dataclass(frozen=True, slots=True)
    class Worded:
        slipping: str
        heat_ratio: float

    found = complaint(GOOD, Worded, "GEAR_INFO")

    assert "slipping: Worded.slipping is <class 'str'>; use float, int, bool" in found


def test_every_error_has_its_own_line() -> None:
    text = changed('(10,0) [0|400000] "N"', '(10,0) [0|400000] "kN"')
    text = text.replace('VAL_ 256 enabled 1 "FALSE" 2 "TRUE" ;', "")

    found = complaint(text).splitlines()

    assert len([line for line in found if ": GEAR_CMD: force_n: unit is" in line]) == 1
    assert len([line for line in found if ": enabled: value table says" in line]) == 2


def test_an_unknown_message_is_named_with_the_nearest_known_one() -> None:
    text = complaint(GOOD, message="GEAR_CMMD")

    assert text == "bad.dbc: GEAR_CMMD: no such message; did you mean GEAR_CMD?"


def test_a_missing_file_is_named() -> None:
    with pytest.raises(BindingError, match=r"tracion\.dbc: no such file; .*traction\.dbc"):
        frame("tracion.dbc", "TRACTION_CMD")(GearCommand)
    with pytest.raises(BindingError, match=r"nowhere/gear\.dbc: cannot be read: No such file"):
        frame(Path("nowhere/gear.dbc"), "GEAR_CMD")(GearCommand)


@pytest.mark.parametrize(
    ("damage", "words"),
    [
        (lambda text: text.replace("BO_ 256", "BO_ two"), "not a usable DBC file"),
        (lambda text: text.replace("force_n : 0|16", "force_n : 8|16", 1), "overlapping"),
        (lambda text: text.replace("BO_ 512", "BO_ 256").replace(
            'VAL_ 512 slipping 0 "FALSE" 1 "TRUE" ;', ""), "identifier 0x100 is also that of"),
        (lambda text: text.replace("512 GEAR_INFO", "512 GEAR_CMD", 1), "name GEAR_CMD is also"),
        (lambda text: text.replace(" 4712;", " 4711;"), "SafetyDataId 4711 is also that of"),
        (lambda text: text.replace('"TimeoutMs" INT 0 65535', '"TimeoutMs" STRING').replace(
            '"TimeoutMs" BO_ 256 200', '"TimeoutMs" BO_ 256 "soon"').replace(
            '"TimeoutMs" BO_ 257 200', '"TimeoutMs" BO_ 257 "soon"').replace(
            'DEF_ "TimeoutMs" 0', 'DEF_ "TimeoutMs" ""'), "TimeoutMs is 'soon'"),
    ],
)  # fmt: skip
def test_a_file_that_contradicts_itself_is_refused(
    damage: Callable[[str], str], words: str
) -> None:
    text = damage(GOOD)
    assert text != GOOD

    assert words in complaint(text)


class Ratio(enum.IntEnum):
    LOW = 1
    MIDDLE = 2
    HIGH = 3


@dataclass(frozen=True, slots=True)
class RatioCommand:
    force_n: float
    accel_mps2: float
    gear: Ratio
    enabled: bool
    steps: int


def test_a_choice_that_begins_above_zero_has_a_twin_that_ends_below_the_top() -> None:
    """With two bits, the inverted values of 1, 2 and 3 are 2, 1 and 0."""
    text = GOOD
    for old, new in (
        ("gear : 24|2@1+ (1,0) [1|3]", "gear : 24|2@1+ (1,0) [0|02]"),
        ("gear : 24|2@1+ (1,0) [0|2]", "gear : 24|2@1+ (1,0) [1|3]"),
        ('gear 0 "NEUTRAL" 1 "FORWARD" 2 "REVERSE"', 'gear 1 "LOW" 2 "MIDDLE" 3 "HIGH"'),
        ('gear 3 "NEUTRAL" 2 "FORWARD" 1 "REVERSE"', 'gear 2 "LOW" 1 "MIDDLE" 0 "HIGH"'),
        ("SG_ 257 gear 3;", 'SG_ 257 gear 2;\nBA_ "GenSigStartValue" SG_ 256 gear 1;'),
    ):
        assert text.count(old) == 1, old
        text = text.replace(old, new)

    gear = bound(text, RatioCommand).fields[2]

    assert (gear.raw_minimum, gear.raw_maximum) == (1, 3)


def test_a_start_value_of_all_ones_has_a_twin_that_starts_with_none() -> None:
    line = 'BA_ "GenSigStartValue" SG_ 257 force_n 65535;'
    for instead in (line.replace("257", "256"), f"{line.replace('257', '256')}\n{line[:-6]}0;"):
        assert bound(changed(line, instead)).twin is not None


def test_a_class_is_bound_by_the_decorator_from_a_path(tmp_path: Path) -> None:
    path = tmp_path / "gear.dbc"
    path.write_text(GOOD)

    kind = frame(path, "GEAR_INFO")(GearInfo)

    assert kind is GearInfo
    assert binding.can_id(GearInfo) == 512
    assert binding.sender(GearInfo) == "TCU"
    assert binding.period_s(GearInfo) == 0.1
    assert binding.message(GearInfo).name == "GEAR_INFO"
    assert not binding.is_vital(GearInfo)
    assert GearInfo not in binding.kinds()


def test_a_bad_class_fails_where_it_is_decorated(tmp_path: Path) -> None:
    path = tmp_path / "bad.dbc"
    path.write_text(changed('"" VOBC\n SG_ heat', '"m" VOBC\n SG_ heat'))

    with pytest.raises(BindingError, match="slipping"):

        @frame(path, "GEAR_INFO")
        @dataclass(frozen=True, slots=True)
        class Bad:
            slipping: bool
            heat_ratio: float


def test_an_event_driven_message_has_no_period_and_no_timeout() -> None:
    kind = EMERGENCIES[Node.DCU]

    assert binding.period_s(kind) == 0.0
    assert binding.timeout_s(kind) == math.inf


def test_a_vital_message_is_recognised() -> None:
    assert binding.is_vital(BrakeCommand)
    assert [message.frame_id for message in binding.binding_of(BrakeCommand).messages] == [
        0x101,
        0x102,
    ]
