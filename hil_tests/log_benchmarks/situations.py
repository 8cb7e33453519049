"""Situations from public bug reports, and which tools read them correctly: `make bench-logs`.

Each tool reads in its own process, so that a tool that hangs or crashes only counts as wrong.
`python -m hil_tests.log_benchmarks.situations` prints the table of docs/results/canlog_peers.md.
"""

import contextlib
import io
import json
import struct
import subprocess
import sys
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cantools.database

from hil_tests.log_benchmarks import peers
from hil_tests.unit.canlog.mf4_rig import MadeFrame, sorted_file

PATIENCE_S = 30
Answer = list[Any]
HEAD = 'VERSION ""\nBU_: A\n'


@dataclass(frozen=True, slots=True)
class Situation:
    """Files of one bug report, and the correct content of the log."""

    name: str
    source: str
    what: str
    files: Mapping[str, bytes]
    right: Answer
    """Correct answer: identifier and data of each frame, or the values of all frames with a DBC
    file.
    """

    @property
    def log(self) -> str:
        return next(name for name in self.files if not name.endswith(".dbc"))

    @property
    def dbc(self) -> str:
        return next((name for name in self.files if name.endswith(".dbc")), "")


def blf(*objects: bytes) -> bytes:
    """Return a BLF file with one stored container after an empty head."""
    content = b"".join(objects)
    out = b"LOGG" + struct.pack("<L", 144) + bytes(136)
    out += struct.pack("<4sHHIIH6xI4x", b"LOBJ", 16, 1, 32 + len(content), 10, 0, len(content))
    return out + content + bytes(len(content) % 4)


def blf_object(kind: int, body: bytes, *, size: int | None = None, fill: bool = True) -> bytes:
    whole = 32 + len(body)
    head = struct.pack("<4sHHII", b"LOBJ", 32, 1, whole if size is None else size, kind)
    return head + struct.pack("<IHHQ", 2, 0, 0, 1000) + body + bytes(whole % 4 if fill else 0)


def classic(identifier: int, data: bytes) -> bytes:
    return blf_object(1, struct.pack("<HBBI8s", 1, 0, len(data), identifier, data))


def fast(identifier: int, data: bytes, code: int) -> bytes:
    fixed = (1, code, len(data), 0, identifier, 0, 0x1000, 0, 0, 0, 0, 0, 0, 0, 0)
    return blf_object(101, struct.pack("<BBBBIIIIIIIHBBI", *fixed) + data)


def asc(*lines: str, date: str = "Tue Jan 07 01:14:48.626 pm 2020") -> bytes:
    head = f"date {date}\nbase hex  timestamps absolute\ninternal events logged\n"
    return (head + "".join(f"{line}\n" for line in lines)).encode()


def candump(*frames: str) -> bytes:
    lines = [f"({1_700_000_000 + at}.000000) can0 {each}\n" for at, each in enumerate(frames)]
    return "".join(lines).encode()


def mf4(*frames: tuple[int, bool, bytes], finished: bool = True) -> bytes:
    """Return an MF4 file of frames (identifier, extended, data)."""
    made = [
        MadeFrame(at * 1000, 1, identifier, extended, False, False, data)
        for at, (identifier, extended, data) in enumerate(frames)
    ]
    return sorted_file(made, finished=finished, start_ns=1_700_000_000_000_000_000)


LONG_NAME = HEAD + (
    "BO_ 513 Long: 8 A\n"
    ' SG_ SelectorOfTheTenHertzLoggingPa_1 M : 0|8@1+ (1,0) [0|7] "" A\n'
    ' SG_ PumpSpeed m0 : 8|16@1+ (1,0) [0|0] "rpm" A\n'
    ' SG_ ValveFlow m1 : 8|16@1+ (0.1,0) [0|0] "%" A\n'
    'BA_DEF_ SG_  "SystemSignalLongSymbol" STRING ;\n'
    'BA_ "SystemSignalLongSymbol" SG_ 513 SelectorOfTheTenHertzLoggingPa_1 "SelectorOfPages";\n'
)
J1939 = HEAD + (
    "BO_ 2364540158 EEC1: 8 Vector__XXX\n"
    ' SG_ EngSpeed : 24|16@1+ (0.125,0) [0|8031.875] "rpm" Vector__XXX\n'
    'BA_DEF_ BO_  "VFrameFormat" ENUM  "StandardCAN","ExtendedCAN","reserved","J1939PG";\n'
    'BA_DEF_DEF_  "VFrameFormat" "J1939PG";\nBA_ "VFrameFormat" BO_ 2364540158 3;\n'
)
NO_BIT_31 = HEAD + (
    'BO_ 274923520 Door: 2 A\n SG_ Open : 0|1@1+ (1,0) [0|1] "" A\n'
    'BO_ 256 Speed: 2 A\n SG_ V : 0|16@1+ (0.01,0) [0|0] "km/h" A\n'
)
STRAY = HEAD + 'BO_ 256 Speed: 2 A\n SG_ V : 0|16@1+ (.25,0) [0|0] "" A\nVAL_ 9 X 1 "y" ;\n'
J1939_BESIDE = J1939.replace(
    "BA_DEF_ ", 'BO_ 256 Speed: 2 A\n SG_ V : 0|16@1+ (0.01,0) [0|0] "km/h" A\nBA_DEF_ ', 1
)
BOTH_SIZES = HEAD + (
    'BO_ 201 Short: 1 A\n SG_ S : 0|8@1+ (1,0) [0|0] "" A\n'
    'BO_ 2147483849 Long: 1 A\n SG_ L : 0|8@1+ (2,0) [0|0] "" A\n'
)
EIGHT = "01 02 03 04 05 06 07 08"
SITUATIONS: Sequence[Situation] = (
    Situation("BLF of CAN FD only", "python-can #1905", "objects of kind 101 alone",
              {"x.blf": blf(fast(0x100, bytes(64), 15), fast(0x101, bytes(12), 9))},
              [[0x100, "00" * 64], [0x101, "00" * 12]]),
    Situation("BLF object without padding", "python-can #1186", "75 bytes between two frames",
              {"x.blf": blf(classic(0x100, b"\1"), blf_object(11, bytes(43), fill=False),
                            classic(0x102, b"\2"))},
              [[0x100, "01"], [0x102, "02"]]),
    Situation("BLF object of size 0", "python-can #1584", "the walk goes on once",
              {"x.blf": blf(classic(0x100, b"\1"), blf_object(1, b"", size=0),
                            classic(0x102, b"\2"))},
              [[0x100, "01"], [0x102, "02"]]),
    Situation("ASC: CANFD with flags 0", "python-can test data", "64 bytes are CAN FD",
              {"x.asc": asc(" 30.5 CANFD   4 Rx        4EE    0 1 f 64 " + "00 " * 64
                            + "1331984   11        0 46500250 460a0250 20011736 20010205")},
              [[0x4EE, "00" * 64]]),
    Situation("ASC of other buses", "Vector logs", "LIN and statistics among frames",
              {"x.asc": asc(f"   0.1 1  123             Rx   d 8 {EIGHT}",
                            "   0.2 L1 2d              Rx     2 01 02  checksum = 46",
                            "   0.3 1  Statistic: D 1 R 0 XD 0 XR 0 E 0 O 0 B 0.00%",
                            f"   0.4 1  124x            Tx   d 8 {EIGHT}")},
              [[0x123, EIGHT.replace(" ", "")], [0x124, EIGHT.replace(" ", "")]]),
    Situation("candump prints an error frame", "cantools #817", "then data",
              {"x.log": b"  can0  20000004   [8]  00 04 00 00 00 00 00 00   ERRORFRAME\n"
                        b"  can0  123   [2]  01 02\n"},
              [[0x4, "0004000000000000"], [0x123, "0102"]]),
    Situation("TRC without reserved column", "SavvyCAN #1045", "$COLUMNS=N,O,T,B,I,d,L,D",
              {"x.trc": b";$FILEVERSION=2.1\n;$STARTTIME=46062.4524670150\n"
                        b";$COLUMNS=N,O,T,B,I,d,L,D\n"
                        b"      1         0.000 DT 1     0102 Rx 2    00 01\n"
                        b"      2         2.900 DT 2 18FEF100 Tx 1    20\n"},
              [[0x102, "0001"], [0x18FEF100, "20"]]),
    Situation("MF4 of a logger that lost power", "asammdf #727", "all but the torn last record",
              {"x.mf4": mf4((0x100, False, b"\1"), (0x101, False, b"\2"), (0x102, False, b"\3"),
                            finished=False)[:-7]},
              [[0x100, "01"], [0x101, "02"]]),
    Situation("MF4: 29-bit identifier below 800", "asammdf #905", "another message than that of 11",
              {"x.mf4": mf4((0xC9, False, b"\5"), (0xC9, True, b"\5")),
               "x.dbc": BOTH_SIZES.encode()},
              [{"S": 5.0}, {"L": 10.0}]),
    Situation("DBC: J1939 beside 11 bits", "asammdf #921", "both are decoded",
              {"x.dbc": J1939_BESIDE.encode(),
               "x.log": candump("0CF004FE#F07D859B0FFFFF85", "100#0102")},
              [{"EngSpeed": 499.375}, {"V": 5.13}]),
    Situation("DBC: long selector name", "cantools #539", "pages stay apart",
              {"x.dbc": LONG_NAME.encode(), "x.log": candump("201#00E803", "201#01E803")},
              [{"PumpSpeed": 1000.0}, {"ValveFlow": 100.0}]),
    Situation("DBC: J1939 source address", "cantools #160", "any source address",
              {"x.dbc": J1939.encode(),
               "x.log": candump("0CF00400#F07D859B0FFFFF85", "0CF00403#F07D859B0FFFFF85")},
              [{"EngSpeed": 499.375}, {"EngSpeed": 499.375}]),
    Situation("DBC: 29 bits without bit 31", "cantools #199", "the rest of the file is used",
              {"x.dbc": NO_BIT_31.encode(), "x.log": candump("100#0102")},
              [{"V": 5.13}]),
    Situation("DBC: stray VAL_ and .25", "opendbc", "the rest of the file is used",
              {"x.dbc": STRAY.encode(), "x.log": candump("100#0400")},
              [{"V": 1.0}]),
)  # fmt: skip


def by_canlog(log: Path, dbc: Path | None) -> Answer:
    from canlog import read

    found = read(log, dbc if dbc is not None else [])
    if dbc is None:
        return [
            [int(found.frames.identifier[at]), found.frames.payload(at).hex()]
            for at in range(len(found))
        ]
    told: list[dict[str, float]] = [{} for _ in range(len(found))]
    for name in found.messages:
        table = found.table(name)
        for signal in table.names:
            rows = zip(table.rows, table[signal], table.valid(signal), strict=True)
            for row, value, there in rows:
                if there:
                    told[int(row)][signal] = float(value)
    return told


def by_python_can(log: Path, dbc: Path | None) -> Answer:
    reader = peers.READERS[log.suffix]
    database: Any = cantools.database.load_file(dbc, strict=False) if dbc is not None else None
    found: Answer = []
    for message in reader(str(log)):
        if database is None:
            found.append([message.arbitration_id, bytes(message.data or b"").hex()])
            continue
        values = database.decode_message(
            message.arbitration_id, message.data, decode_choices=False, allow_truncated=True
        )
        found.append({name: float(value) for name, value in values.items()})
    return found


def by_hilspy(log: Path, dbc: Path | None) -> Answer:
    import hilspy

    if log.suffix not in (".log", ".blf", ".asc"):
        raise NoReaderError
    form = "?format=candump" if log.suffix == ".log" else ""
    found: Answer = []
    files = [f"dbc:{dbc}"] if dbc is not None else []
    with hilspy.open(f"file://{log}{form}", *files) as channel:
        for message in channel:
            if dbc is not None:
                found.append({name: float(each) for name, each in message.fields.items()})
            else:
                found.append([message.id, bytes(message.data or b"").hex()])
    return found


def by_asammdf(log: Path, dbc: Path | None) -> Answer:
    """Read a log in MF4; another log is first converted, because the DBC file is the question."""
    import asammdf

    if log.suffix != ".mf4":
        if dbc is None:
            raise NoReaderError
        from canlog.convert import convert

        convert(log, log.with_suffix(".mf4"))
    with asammdf.MDF(str(log.with_suffix(".mf4"))) as file:
        if dbc is None:
            return _asammdf_frames(file)
        return _asammdf_values(file.extract_bus_logging({"CAN": [(str(dbc), 0)]}))


def _asammdf_frames(file: Any) -> Answer:
    identifier, size, data = (
        file.get(f"CAN_DataFrame.{name}").samples for name in ("ID", "DataLength", "DataBytes")
    )
    rows = zip(identifier.tolist(), size.tolist(), data, strict=True)
    return [[key, bytes(row[:length]).hex()] for key, length, row in rows]


def _asammdf_values(file: Any) -> Answer:
    """Return the values by stamp: each frame of a situation has its own."""
    told: dict[float, dict[str, float]] = {}
    for index, group in enumerate(file.groups):
        for channel in group.channels[1:]:
            signal = file.get(channel.name, group=index, raw=False)
            for at_s, value in zip(signal.timestamps, signal.samples, strict=True):
                told.setdefault(round(float(at_s), 6), {})[channel.name] = float(value)
    return [told[at_s] for at_s in sorted(told)]


class NoReaderError(Exception):
    """The tool does not claim to read this format."""


TOOLS: Mapping[str, Callable[[Path, Path | None], Answer]] = {
    "canlog": by_canlog,
    "python-can + cantools": by_python_can,
    "asammdf": by_asammdf,
    "hilspy": by_hilspy,
}


def is_right(answer: Answer, right: Answer) -> bool:
    """Compare frames exactly; compare only the requested values, and allow no value of another
    page.
    """
    if len(answer) != len(right):
        return False
    for got, wanted in zip(answer, right, strict=True):
        if isinstance(wanted, dict):
            pages = {"PumpSpeed", "ValveFlow"} & set(got)
            if any(got.get(name) != value for name, value in wanted.items()):
                return False
            if pages - set(wanted):
                return False
        elif got != wanted:
            return False
    return True


def tried(tool: str, situation: Situation) -> str:
    """Try a tool in its own process: right, wrong, or a dash where it has no reader."""
    with tempfile.TemporaryDirectory() as folder:
        for name, content in situation.files.items():
            (Path(folder) / name).write_bytes(content)
        words = [sys.executable, "-m", __spec__.name, tool, folder, situation.log, situation.dbc]
        try:
            done = subprocess.run(
                words, capture_output=True, text=True, timeout=PATIENCE_S, check=True
            )
            answer = json.loads(done.stdout)
        except (subprocess.SubprocessError, ValueError):
            return "wrong"
    if answer is None:
        return "–"
    return "right" if is_right(answer, situation.right) else "wrong"


def table() -> list[tuple[Situation, dict[str, str]]]:
    """Return for each situation how each tool answers."""
    return [(each, {tool: tried(tool, each) for tool in TOOLS}) for each in SITUATIONS]


def main(words: Sequence[str]) -> int:
    if words:
        tool, folder, log, dbc = words
        said = io.StringIO()
        answer: Answer | None = None
        with contextlib.redirect_stdout(said), contextlib.suppress(NoReaderError):
            answer = TOOLS[tool](Path(folder) / log, Path(folder) / dbc if dbc else None)
        print(json.dumps(answer))
        return 0
    print(f"| situation | source | {' | '.join(TOOLS)} |")
    print("|---|---|" + "---|" * len(TOOLS))
    for each, right in table():
        marks = " | ".join(right[tool] for tool in TOOLS)
        print(f"| {each.name}: {each.what} | {each.source} | {marks} |")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
