"""DBC files with flaws: each flaw becomes a warning with its line, and the rest is used."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from cantools.database.can import Database
from hypothesis import given, settings
from hypothesis import strategies as st

from canlog import LogError, load_bus, read, table_of
from canlog.command import main
from canlog.database import bus_of, parse_bus
from canlog.dbc_text import dbc_text
from canlog.frames import KEY_EXTENDED
from hil_tests.unit.canlog.canlog_rig import EVERYTHING

HEAD = 'VERSION ""\nBU_: A B\n'


def values(dbc: str, message: str, data: str) -> dict[str, float | None]:
    """Decode one frame; None for a signal that it does not carry."""
    table = table_of(parse_bus(HEAD + dbc).message(message), [bytes.fromhex(data)])
    return {name: table[name].tolist()[0] if table.valid(name)[0] else None for name in table.names}


@pytest.mark.parametrize(
    ("flawed", "kind", "line"),
    [
        ('VAL_ 256 Nothing 1 "x" ;', "stray VAL_", 6),
        ('VAL_ 999 V 1 "x" ;', "stray VAL_", 6),
        ("SIG_VALTYPE_ 256 Nothing : 1;", "stray SIG_VALTYPE_", 6),
        ('CM_ SG_ 999 V "of nothing";', "stray CM_", 6),
        ('CM_ 145 "of nothing";', "unreadable statement", 6),
        ('CM_ "without an end"', "statement without its end", 6),
        ('BA_ "X" SG_ 256 Nothing 5;', "stray BA_", 6),
        ("what is this", "unreadable statement", 6),
        ('BO_ 256 Again: 8 A\n SG_ V : 0|8@1+ (1,0) [0|0] "" A', "duplicate identifier", 6),
        ('BO_ 274923520 Door: 2 A\n SG_ Open : 0|1@1+ (1,0) [0|1] "" A',
         "identifier without bit 31", 6),
        ("BO_ 4294967295 Bad: 2 A", "impossible identifier", 6),
        ('BO_ 257 Two: 2 A\n SG_ W : 0|0@1+ (1,0) [0|1] "" A', "impossible signal", 7),
        ('BO_ 257 Two: 2 A\n SG_ W m1 : 0|4@1+ (1,0) [0|1] "" A', "page without a selector", 7),
        ('BO_ 257 Two: 2 A\n SG_ W : 0|4@1+ (1,0) [0|1] "" A\n SG_ W : 4|4@1+ (1,0) [0|1] "" A',
         "duplicate signal", 8),
    ],
)  # fmt: skip
def test_a_flaw_is_a_warning_with_its_line_and_the_rest_is_used(
    flawed: str, kind: str, line: int
) -> None:
    good = 'BO_ 256 Speed: 2 A\n SG_ V : 0|16@1+ (0.01,0) [0|0] "km/h" B\n'
    last = 'BO_ 512 Last: 1 B\n SG_ L : 0|8@1+ (1,0) [0|0] "" A\n'

    bus = parse_bus(f"{HEAD}{good}\n{flawed}\n{last}", "x.dbc")

    assert any(each.startswith(f"x.dbc: 1 x {kind} at line {line}:") for each in bus.warnings)
    assert "Last" in bus.messages
    assert 256 in bus.by_key


@pytest.mark.parametrize(
    "line",
    [
        'SG_ 0_COUNTER : 0|8@1+ (1,0) [0|0] "" A',
        'SG_ V : 0|8@1+ (.25,0) [0|0] "" A',
        'SG_ V : 0|8@1+ (1.,-.5) [0|0] "" A',
        'SG_ V:0|8@1+(1E0,0)[0|0]"" A',
        'SG_ V : 0|8@1+ (1,0) "" A',
        "SG_ V : 0|8@1+ (1,0) [0|0]",
    ],
)
def test_signals_are_read_however_they_are_written(line: str) -> None:
    bus = parse_bus(f"{HEAD}BO_ 256 2017_5: 8 A\n {line}\n")

    assert [each.length for each in bus.message("2017_5").signals] == [8]
    assert bus.warnings == ()


def test_an_identifier_without_bit_31_is_taken_as_extended() -> None:
    bus = parse_bus(HEAD + 'BO_ 274923520 Door: 2 A\n SG_ Open : 0|1@1+ (1,0) [0|1] "" A\n')

    assert bus.message("Door").key == 274923520 | KEY_EXTENDED
    assert "Door: 274923520 has more than 11 bits" in bus.warnings[0]


def test_two_messages_of_one_name_are_both_decoded() -> None:
    bus = parse_bus(
        HEAD
        + 'BO_ 256 M: 1 A\n SG_ V : 0|8@1+ (1,0) [0|0] "" A\n'
        + 'BO_ 257 M: 1 A\n SG_ W : 0|8@1+ (1,0) [0|0] "" A\n'
    )

    assert {spec.name: spec.key for spec in bus.by_key.values()} == {"M": 256, "M_101": 257}
    assert "called M_101" in bus.warnings[0]


LONG = """\
BO_ 513 Long: 8 A
 SG_ SelectorOfTheTenHertzLoggingPa_1 M : 0|8@1+ (1,0) [0|7] "" A
 SG_ PumpSpeed m0 : 8|16@1+ (1,0) [0|0] "rpm" A
 SG_ ValveFlow m1 : 8|16@1+ (0.1,0) [0|0] "%" A
BA_DEF_ SG_  "SystemSignalLongSymbol" STRING ;
BA_ "SystemSignalLongSymbol" SG_ 513 SelectorOfTheTenHertzLoggingPa_1 "SelectorOfAllPages";
"""


def test_a_selector_with_a_long_name_keeps_its_pages_apart() -> None:
    first, second = (values(LONG, "Long", f"{page:02X}E803") for page in (0, 1))

    assert (first["PumpSpeed"], first["ValveFlow"]) == (1000, None)
    assert (second["PumpSpeed"], second["ValveFlow"]) == (None, 100.0)
    assert second["SelectorOfAllPages"] == 1


def test_one_name_in_two_pages_is_read_from_the_page_of_the_frame() -> None:
    dbc = (
        "BO_ 513 M: 8 A\n"
        ' SG_ Page M : 0|8@1+ (1,0) [0|7] "" A\n'
        ' SG_ V m0 : 8|8@1+ (1,0) [0|0] "" A\n'
        ' SG_ V m1 : 16|8@1+ (0.5,0) [0|0] "" A\n'
    )

    assert values(dbc, "M", "000A0B")["V"] == 10
    assert values(dbc, "M", "010A0B")["V"] == 5.5
    assert values(dbc, "M", "020A0B")["V"] is None


NESTED = """\
BO_ 2024 OBD2: 8 A
 SG_ service M : 11|4@0+ (1,0) [0|15] "" A
 SG_ PID m1M : 23|8@0+ (1,0) [0|255] "" A
 SG_ Speed m13 : 31|8@0+ (1,0) [0|255] "km/h" A
 SG_ Rpm m12 : 31|16@0+ (0.25,0) [0|16383.75] "rpm" A
SG_MUL_VAL_ 2024 PID service 1-1;
SG_MUL_VAL_ 2024 Speed PID 13-13;
SG_MUL_VAL_ 2024 Rpm PID 12-12, 20-22;
"""


@pytest.mark.parametrize(
    ("data", "rpm", "speed"),
    [("04410C166CFFFFFF", 1435.0, None), ("03410D37FFFFFFFF", None, 55),
     ("0441151000000000", 1024.0, None), ("0442151000000000", None, None)],
)  # fmt: skip
def test_pages_may_hang_on_pages_and_be_ranges(
    data: str, rpm: float | None, speed: float | None
) -> None:
    found = values(NESTED, "OBD2", data)

    assert (found["Rpm"], found["Speed"]) == (rpm, speed)


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "cp1252"])
def test_units_are_read_in_either_encoding(tmp_path: Path, encoding: str) -> None:
    path = tmp_path / "x.dbc"
    text = HEAD + 'BO_ 256 T: 2 A\n SG_ Oil : 0|16@1- (0.1,-40) [0|0] "°C" A\n'
    path.write_bytes((text + 'VAL_ 256 Oil -1 "ungültig" 0 "kühl" ;\n').encode(encoding))

    oil = load_bus(path).message("T").signal("Oil")

    assert (oil.unit, oil.choices) == ("°C", {-1: "ungültig", 0: "kühl"})


@pytest.mark.parametrize("order", ["1", "0"])
def test_signals_of_more_than_64_bits_are_whole(order: str, tmp_path: Path) -> None:
    start = 0 if order == "1" else 7
    dbc = f'{HEAD}BO_ 256 M: 16 A\n SG_ Serial : {start}|128@{order}+ (1,0) [0|0] "" A\n'
    data = bytes(range(1, 17))
    (tmp_path / "x.dbc").write_text(dbc)
    (tmp_path / "x.log").write_text(f"(1.000000) can0 100##0{data.hex()}\n")

    table = table_of(parse_bus(dbc).message("M"), [data])
    code = main(
        ["extract", str(tmp_path / "x.log"), "--dbc", str(tmp_path / "x.dbc"), "-o", str(tmp_path),
         "--as", "csv"]
    )  # fmt: skip

    wanted = int.from_bytes(data, "little" if order == "1" else "big")
    assert table["Serial"].tolist() == [wanted]
    assert code == 0
    assert hex(wanted) in (tmp_path / "M.csv").read_text()


J1939 = """\
BO_ 2364540158 EEC1: 8 Vector__XXX
 SG_ EngSpeed : 24|16@1+ (0.125,0) [0|8031.875] "rpm" Vector__XXX
BO_ 2566844926 CCVS: 8 Vector__XXX
 SG_ WheelSpeed : 8|16@1+ (0.00390625,0) [0|250] "km/h" Vector__XXX
BA_DEF_ BO_  "VFrameFormat" ENUM  "StandardCAN","ExtendedCAN","reserved","J1939PG";
BA_DEF_DEF_  "VFrameFormat" "J1939PG";
BA_ "VFrameFormat" BO_ 2364540158 3;
"""


def test_messages_of_j1939_come_with_any_priority_and_source(tmp_path: Path) -> None:
    (tmp_path / "x.dbc").write_text(HEAD + J1939)
    (tmp_path / "x.log").write_text(
        "(1.000000) can0 0CF00400#F07D859B0FFFFF85\n(1.100000) can0 0CF00403#F07D859B0FFFFF85\n"
        "(1.200000) can0 18FEF131#FF0028FFFFFFFFFF\n(1.300000) can0 10F004FE#F07D859B0FFFFF85\n"
        "(1.400000) can0 18FEEE00#FF0028FFFFFFFFFF\n"
    )

    log = read(tmp_path / "x.log", dbc=tmp_path / "x.dbc")

    assert log.table("EEC1")["EngSpeed"].tolist() == [499.375] * 3
    assert log.table("EEC1").rows.tolist() == [0, 1, 3]
    assert log.table("CCVS")["WheelSpeed"].tolist() == [40.0]
    assert log.unknown == (0x18FEEE00 | KEY_EXTENDED,)


def test_what_is_no_dbc_file_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "x.dbc").write_text("this is a letter\n")
    (tmp_path / "x.log").write_text("(1.000000) can0 100#01\n")

    code = main(["show", str(tmp_path / "x.log"), "--dbc", str(tmp_path / "x.dbc"), "--no-pager"])

    assert code == 2
    assert "x.dbc: not a usable DBC file" in capsys.readouterr().err
    with pytest.raises(LogError, match="No such file"):
        load_bus(tmp_path / "absent.dbc")


def test_flaws_are_told_on_standard_error(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "x.dbc").write_text(f'{HEAD}BO_ 256 M: 1 A\nVAL_ 9 V 1 "x" ;\n')
    (tmp_path / "x.log").write_text("(1.000000) can0 100#01\n")

    code = main(["show", str(tmp_path / "x.log"), "--dbc", str(tmp_path / "x.dbc"), "--no-pager"])

    said = capsys.readouterr()
    assert (code, said.out.count("\n")) == (0, 1)
    assert "warning:" in said.err
    assert "x.dbc: 1 x stray VAL_ at line 4: there is no message 9" in said.err


KCD = """\
<NetworkDefinition xmlns="http://kayak.2codeornot2code.org/1.0"><Document name="d"/>
<Bus name="b"><Message id="0x100" length="1" name="M"><Signal name="V" offset="0" length="8"/>
</Message></Bus></NetworkDefinition>
"""
SYM = """\
FormatVersion=6.0 // Do not edit this line!
Title="x"

{SIGNALS}
Sig=V unsigned 8

{SENDRECEIVE}

[M]
ID=100h
Len=1
Sig=V 0
"""


@pytest.mark.parametrize(("name", "text"), [("x.kcd", KCD), ("x.sym", SYM)])
def test_other_kinds_of_files_go_through_cantools(tmp_path: Path, name: str, text: str) -> None:
    (tmp_path / name).write_text(text)
    (tmp_path / "x.log").write_text("(1.000000) can0 100#2A\n")

    assert read(tmp_path / "x.log", dbc=tmp_path / name).table("M")["V"].tolist() == [42]

    (tmp_path / name).write_text("nonsense")
    with pytest.raises(LogError, match=name.replace(".", r"\.")):
        load_bus(tmp_path / name)


def test_everything_of_the_rig_is_read_as_cantools_reads_it() -> None:
    database = Database(strict=False)
    database.add_dbc_string(EVERYTHING)

    assert parse_bus(EVERYTHING, "x").by_key == bus_of(database, "x").by_key


SIGNALS = st.lists(
    st.tuples(
        st.integers(0, 63),
        st.integers(1, 32),
        st.booleans(),
        st.booleans(),
        st.sampled_from(["1", "0.5", "-2", "1e-3", "0.1"]),
        st.sampled_from(["0", "-40", "2.5"]),
        st.dictionaries(st.integers(-3, 9), st.sampled_from(["ON", "a b", 'q\\"q']), max_size=3),
    ),
    min_size=1,
    max_size=6,
)


@given(signals=SIGNALS, data=st.binary(min_size=8, max_size=8), pages=st.booleans())
@settings(max_examples=60, deadline=None)
def test_values_are_those_of_cantools(
    signals: Sequence[tuple[int, int, bool, bool, str, str, dict[int, str]]],
    data: bytes,
    *,
    pages: bool,
) -> None:
    """Signals have any position, byte order, sign, factor and value table, in pages or not."""
    lines, tables = [], []
    for at, (start, length, big, signed, scale, offset, choices) in enumerate(signals):
        lines.append(f"BO_ {256 + at} M{at}: 8 A")
        if pages:
            lines.append(' SG_ Page M : 0|1@1+ (1,0) [0|1] "" B')
            start = 8 + start % 56
        byte, bit = divmod(start, 8)
        begin = 8 * byte + 7 - bit if big else start
        lines.append(
            f" SG_ s{' m1' if pages else ''} : {begin}|{min(length, 64 - start)}"
            f'@{0 if big else 1}{"-" if signed else "+"} ({scale},{offset}) [0|0] "u" B'
        )
        if choices:
            pairs = " ".join(f'{raw} "{name}"' for raw, name in choices.items())
            tables.append(f"VAL_ {256 + at} s {pairs} ;")
    text = HEAD + "\n".join([*lines, *tables]) + "\n"
    database = Database(strict=False)
    database.add_dbc_string(text)
    bus = parse_bus(text, "x")
    # cantools rejects a frame whose page has no signal.
    data = bytes([data[0] | pages]) + data[1:]

    assert bus.by_key == bus_of(database, "x").by_key
    for key, spec in bus.by_key.items():
        table = table_of(spec, [data])
        wanted = database.decode_message(key, data, decode_choices=False, allow_truncated=True)
        assert isinstance(wanted, dict)
        assert {name for name in table.names if table.valid(name)[0]} == set(wanted)
        for name, value in wanted.items():
            assert np.isclose(float(table[name][0]), float(str(value)), rtol=1e-12, atol=0)


@given(cut=st.integers(0, len(EVERYTHING)), noise=st.text(max_size=20))
@settings(max_examples=60, deadline=None)
def test_any_text_is_read_or_refused(cut: int, noise: str) -> None:
    text = EVERYTHING[:cut] + noise + EVERYTHING[cut:]
    bus = parse_bus(text, "x")

    assert all(spec.key == key for key, spec in bus.by_key.items())


@given(raw=st.binary(max_size=200))
@settings(max_examples=60, deadline=None)
def test_any_bytes_are_some_text(raw: bytes) -> None:
    assert isinstance(dbc_text(raw), str)
