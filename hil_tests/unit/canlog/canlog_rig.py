"""Logs and DBC files for the tests of canlog."""

from collections.abc import Iterable
from pathlib import Path
from typing import Final

import numpy as np

from canlog.database import Bus, parse_bus
from canlog.frames import Frames
from canlog.reader import Log
from canlog.rows import from_rows

MS: Final = 1_000_000
EVERYTHING: Final = """\
VERSION ""
NS_ :
BS_:
BU_: ECU TCMS
BO_ 256 PLAIN: 8 ECU
 SG_ small : 0|4@1+ (1,0) [0|15] "" TCMS
 SG_ signed_mps : 4|12@1- (0.05,-3) [-200|200] "m/s" TCMS
 SG_ motorola : 23|10@0+ (0.5,0) [0|600] "V" TCMS
 SG_ motorola_signed : 39|16@0- (2,1) [-65536|65536] "" TCMS
 SG_ state : 48|3@1+ (1,0) [0|7] "" TCMS
 SG_ flags : 52|4@1+ (1,0) [0|15] "" TCMS
BO_ 257 WIDE: 8 ECU
 SG_ whole : 0|64@1+ (1,0) [0|18446744073709551615] "" TCMS
BO_ 258 WIDE_SIGNED: 8 TCMS
 SG_ whole : 7|64@0- (1,0) [-9223372036854775808|9223372036854775807] "" ECU
BO_ 259 FLOATS: 8 TCMS
 SG_ single : 0|32@1- (1,0) [0|0] "" ECU
 SG_ other : 39|32@0- (2,0.5) [0|0] "" ECU
BO_ 260 DOUBLE: 8 TCMS
 SG_ double : 0|64@1- (1,0) [0|0] "" ECU
BO_ 2147484929 CHOSEN: 8 ECU
 SG_ which M : 0|4@1+ (1,0) [0|15] "" TCMS
 SG_ first m0 : 8|16@1+ (1,0) [0|65535] "" TCMS
 SG_ second m1 : 8|20@1- (0.001,0) [0|0] "kN" TCMS
 SG_ always : 40|8@1+ (1,0) [0|255] "" TCMS
BO_ 262 ODD: 8 ECU
 SG_ crooked : 3|53@1+ (1,0) [0|0] "" TCMS
BA_DEF_ BO_ "GenMsgCycleTime" INT 0 65535;
BA_DEF_DEF_ "GenMsgCycleTime" 0;
BA_ "GenMsgCycleTime" BO_ 256 10;
BA_ "GenMsgCycleTime" BO_ 257 20;
VAL_ 256 state 0 "OFF" 1 "READY" 2 "RUNNING" ;
VAL_ 256 flags 0 "NONE" 1 "DOORS" 2 "BRAKE" 4 "FIRE" 8 "DESK" ;
SIG_VALTYPE_ 259 single : 1;
SIG_VALTYPE_ 259 other : 1;
SIG_VALTYPE_ 260 double : 2;
"""
"""A DBC file with both byte orders, signs, floats, 64 bits, multiplexing, and named values and
flags.
"""
EXTENDED_ID: Final = 0x80000501 & 0x1FFFFFFF
KEYS: Final = ((256, 0), (257, 0), (258, 0), (259, 0), (260, 0), (EXTENDED_ID, 1), (262, 0))


def bus() -> Bus:
    return parse_bus(EVERYTHING, "everything.dbc")


def random_frames(count: int, seed: int = 1) -> Frames:
    """Return frames of all messages in turn, one per millisecond: some short, a few remote or
    error.
    """
    noise = np.random.default_rng(seed)
    rows, lengths = [], []
    for number in range(count):
        identifier, extended = KEYS[number % len(KEYS)]
        data = noise.integers(0, 256, 8, np.uint8).tobytes()
        flags = extended
        if noise.random() < 0.05:
            data = data[: int(noise.integers(0, 8))]
        if noise.random() < 0.01:
            flags |= 2 if noise.random() < 0.5 else 4
        rows.append((number * MS + int(noise.integers(0, 1000)), identifier, flags, "can0", data))
        lengths.append(len(data))
    frames = from_rows([row if not row[2] & 2 else (*row[:4], b"") for row in rows])
    frames.length[:] = lengths
    return frames


def log_of(rows: Iterable[tuple[int, int, bytes]], of_bus: Bus | None = None) -> Log:
    """Return a log of (at_ns, identifier, data) each."""
    frames = from_rows([(at_ns, key, 0, "can0", data) for at_ns, key, data in rows])
    return Log(Path("made_up.log"), frames, of_bus or bus())


def write_candump(path: Path, frames: Frames) -> Path:
    """Write a log like candump, to the microsecond."""
    lines = []
    for row in range(len(frames)):
        seconds, micros = divmod(int(frames.at_ns[row]) // 1000, 1_000_000)
        flags, identifier = int(frames.flags[row]), int(frames.identifier[row])
        if flags & 4:
            text = f"{identifier | 1 << 29:08X}#{frames.payload(row).hex().upper()}"
        else:
            text = f"{identifier:08X}#" if flags & 1 else f"{identifier:03X}#"
            text += f"R{frames.length[row]}" if flags & 2 else frames.payload(row).hex().upper()
        lines.append(f"({seconds:010}.{micros:06}) can0 {text}\n")
    path.write_text("".join(lines), encoding="ascii")
    return path
