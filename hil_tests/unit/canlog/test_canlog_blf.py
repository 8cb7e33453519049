"""BLF files with any mixture of objects, made with struct, give exactly their frames."""

import struct
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import can
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from canlog import Frames, ReadOptions, read, stream
from canlog.frames import BRS, ERROR, EXTENDED, FD, REMOTE, TX, concat

HEAD = b"LOGG" + struct.pack("<L", 144) + bytes(136)
FRAME_OBJECTS = (1, 2, 73, 86, 100, 101, 104)
CODES = [*range(9), 12, 16, 20, 24, 32, 48, 64]


@dataclass(frozen=True, slots=True)
class Made:
    """One object and the frame it encodes; `kind` 0 is an object of another bus."""

    kind: int
    stamp_us: int
    channel: int
    identifier: int
    extended: bool
    sent: bool
    data: bytes
    long_head: bool

    @property
    def payload(self) -> bytes:
        if self.kind in (1, 73, 86):
            return self.data[:8]
        if self.kind == 2:
            return b""
        size = max(each for each in CODES if each <= len(self.data))
        return self.data[:size]


def body(made: Made) -> bytes:
    """Return an object's body, field by field as in Vector's header files."""
    wide = made.identifier | made.extended << 31
    data, size = made.payload, len(made.payload)
    code = CODES.index(size)
    if made.kind in (1, 86):
        packed = struct.pack("<HBBI8s", made.channel, made.sent, size, wide, data)
        return packed + (bytes(8) if made.kind == 86 else b"")
    if made.kind == 2:
        return struct.pack("<HHI", made.channel, 6, 0)
    if made.kind == 73:
        return struct.pack("<HHIBBBxIIHH8s", made.channel, 0, 0, 0, 0, size, 0, wide, 0, 0, data)
    if made.kind == 100:
        return struct.pack(
            "<HBBIIBBB5x64s", made.channel, made.sent, code, wide, 0, 0, 3, size, data
        )
    if made.kind == 101:
        fixed = (made.channel, code, size, 0, wide, 0, 0x3000, 0, 0, 0, 0, 0, made.sent, 0, 0)
        return struct.pack("<BBBBIIIIIIIHBBI", *fixed) + data
    if made.kind == 104:
        head = struct.pack("<BBBBHHHBB", made.channel, code, size, 0, 0, 0, 0, 0, 0)
        return head + struct.pack("<I28x", wide) + data
    return data


def packed(made: Made) -> bytes:
    """Return an object with a head of either version, without padding."""
    content = body(made)
    head = 40 if made.long_head else 32
    kind = made.kind or 11
    base = struct.pack("<4sHHII", b"LOBJ", head, 1 + made.long_head, head + len(content), kind)
    stamps = struct.pack("<IHHQ", 2, 0, 0, made.stamp_us * 1000) + bytes(head - 32)
    return base + stamps + content


def filled(objects: Sequence[bytes], padding: str) -> bytes:
    """Join objects with the padding of different writers."""
    signs = {"vector": 1, "four": -1, "none": 0}
    return b"".join(each + bytes(signs[padding] * len(each) % 4) for each in objects)


def contained(content: bytes, sizes: Sequence[int]) -> bytes:
    """Return stored containers of these sizes, and one for the rest."""
    out, at = HEAD, 0
    for size in (*sizes, len(content)):
        part, at = content[at : at + size], at + size
        out += struct.pack("<4sHHII", b"LOBJ", 16, 1, 32 + len(part), 10)
        out += struct.pack("<H6xI4x", 0, len(part)) + part + bytes(len(part) % 4)
    return out


def told(frames: Frames) -> list[tuple[int, str, int, int, bytes]]:
    return [
        (
            int(frames.at_ns[at]) // 1000,
            frames.channels[frames.channel[at]],
            int(frames.identifier[at]),
            int(frames.flags[at]),
            frames.payload(at),
        )
        for at in range(len(frames))
    ]


def wanted(made: Made) -> tuple[int, str, int, int, bytes]:
    flags = EXTENDED * made.extended | TX * made.sent
    flags |= (FD | BRS) if made.kind in (100, 101) else 0
    if made.kind in (2, 73, 104):
        flags = ERROR
    identifier = 0 if made.kind == 2 else made.identifier
    return made.stamp_us, f"can{made.channel}", identifier, flags, made.payload


OBJECTS = st.lists(
    st.builds(
        Made,
        kind=st.sampled_from([*FRAME_OBJECTS, 1, 86, 0]),
        stamp_us=st.integers(0, 1 << 40),
        channel=st.integers(1, 4),
        identifier=st.integers(0, 0x7FF),
        extended=st.booleans(),
        sent=st.booleans(),
        data=st.binary(max_size=64),
        long_head=st.booleans(),
    ),
    max_size=25,
)


@given(
    made=OBJECTS,
    padding=st.sampled_from(["vector", "four", "none"]),
    sizes=st.lists(st.integers(1, 400), max_size=6),
    compiled=st.booleans(),
    bare=st.booleans(),
)
@settings(max_examples=80, deadline=None)
def test_objects_of_any_mixture_are_read(
    made: list[Made], padding: str, sizes: list[int], *, compiled: bool, bare: bool
) -> None:
    """Containers may be cut anywhere, or be missing."""
    content = filled([packed(each) for each in made], padding)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "x.blf"
        path.write_bytes(HEAD + content if bare else contained(content, sizes))
        source = stream(path, ReadOptions(compiled=compiled))
        frames = concat(list(source))

    assert told(frames) == [wanted(each) for each in made if each.kind]
    assert source.warnings == ()
    foreign = sum(not each.kind for each in made)
    assert source.skipped == ({"object of no CAN frame": foreign} if foreign else {})


@pytest.mark.parametrize("compiled", [True, False])
def test_a_log_of_nothing_but_long_objects_is_read(tmp_path: Path, *, compiled: bool) -> None:
    """A bus that carries only CAN FD gives such a log."""
    made = [
        Made(101, at, 1 + at // 2, 0x100 + at, False, False, bytes(range(size)), False)
        for at, size in enumerate((64, 48, 12))
    ]
    path = tmp_path / "x.blf"
    path.write_bytes(contained(filled([packed(each) for each in made], "vector"), []))

    assert told(read(path, options=ReadOptions(compiled=compiled)).frames) == list(
        map(wanted, made)
    )


def test_an_object_of_size_zero_is_stepped_over_once(tmp_path: Path) -> None:
    one, other = (packed(Made(1, at, 1, 0x100 + at, False, False, b"\1\2", False)) for at in (0, 2))
    nothing = struct.pack("<4sHHII", b"LOBJ", 32, 1, 0, 1) + bytes(32)
    path = tmp_path / "x.blf"
    path.write_bytes(contained(one + nothing + other, []))

    log = read(path)

    assert log.frames.identifier.tolist() == [0x100, 0x102]
    assert log.warnings != ()


def test_a_frame_object_too_short_for_a_frame_is_damage(tmp_path: Path) -> None:
    base = struct.pack("<4sHHII", b"LOBJ", 32, 1, 40, 1) + bytes(24)
    good = packed(Made(1, 5, 1, 0x100, False, False, b"\1", False))
    path = tmp_path / "x.blf"
    path.write_bytes(contained(base + good, []))

    log = read(path)

    assert log.frames.identifier.tolist() == [0x100]
    assert [each.kind for each in log.warnings] == ["corrupt object"]


def test_a_long_identifier_without_its_mark_is_kept_with_a_warning(tmp_path: Path) -> None:
    made = Made(1, 5, 1, 0x18FEF100, False, False, b"\1", False)
    path = tmp_path / "x.blf"
    path.write_bytes(contained(packed(made), []))

    log = read(path)

    assert log.frames.flags.tolist() == [EXTENDED]
    assert [(each.kind, each.count) for each in log.warnings] == [("unmarked identifier", 1)]


def test_remote_frames_of_both_kinds_of_long_objects(tmp_path: Path) -> None:
    """Kind 101 marks remote frames by bit 4 of its flags, kind 100 by bit 7."""
    fixed = (1, 5, 0, 0, 0x123, 0, 0x10, 0, 0, 0, 0, 0, 0, 0, 0)
    newer = struct.pack("<BBBBIIIIIIIHBBI", *fixed)
    older = struct.pack("<HBBIIBBB5x64s", 1, 0x80, 5, 0x124, 0, 0, 0, 0, b"")
    out = b""
    for kind, content in ((101, newer), (100, older)):
        out += struct.pack("<4sHHII", b"LOBJ", 32, 1, 32 + len(content), kind) + bytes(16) + content
    path = tmp_path / "x.blf"
    path.write_bytes(contained(out, []))

    frames = read(path).frames

    assert frames.flags.tolist() == [REMOTE, REMOTE]
    assert frames.length.tolist() == [5, 5]


def test_python_can_agrees_about_a_mixed_file(tmp_path: Path) -> None:
    """The file avoids kind 104 and heads of 40 bytes, which python-can does not read."""
    made = [
        Made(kind, at, 1, 0x100 + at, bool(at % 2), False, bytes(range(8)), False)
        for at, kind in enumerate((1, 86, 100, 101) * 5)
    ]
    path = tmp_path / "x.blf"
    path.write_bytes(contained(filled([packed(each) for each in made], "vector"), [100, 33]))

    theirs = [(each.arbitration_id, bytes(each.data)) for each in can.BLFReader(str(path))]

    frames = read(path).frames
    assert [(int(frames.identifier[at]), frames.payload(at)) for at in range(len(frames))] == theirs
