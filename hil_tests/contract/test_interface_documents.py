"""The interface documents suffice to build the other end: their tables decode their examples."""

import hashlib
import hmac
import itertools
import json
import re
import zlib
from pathlib import Path

import msgspec
import pytest

from firmware_py.radio.inproc_radio import INBOX_MESSAGES
from firmware_py.radio.zenoh_radio import INBOX_MESSAGES as ZENOH_INBOX_MESSAGES
from firmware_py.tag_reader import inproc_line, serial_line, telegram
from firmware_py.tag_reader.telegram import HealthTelegram, TagTelegram, TornReason
from firmware_py.trackdb import TagKind
from zenoh_config import codec, keys
from zenoh_config.messages import (
    RESTRICTIONS_MAX,
    Message,
    MovementAuthority,
    PositionReport,
    RefusedReason,
    SpeedRestriction,
    TrainOrders,
    TrainStatus,
)
from zenoh_config.sessions import DEFAULT_ENDPOINT

DOCS = Path(__file__).parents[2] / "docs"
SERIAL = (DOCS / "reference" / "serial_interface.md").read_text(encoding="utf-8")
RADIO = (DOCS / "reference" / "radio_interface.md").read_text(encoding="utf-8")

Fields = dict[str, str]


def examples(text: str, kind: str) -> list[Fields]:
    blocks = re.findall(rf"^```example {kind}\n(.*?)^```", text, re.MULTILINE | re.DOTALL)
    assert blocks
    return [
        {name: value.strip() for name, _, value in (line.partition("=") for line in lines)}
        for lines in (block.replace(" =", "=").splitlines() for block in blocks)
    ]


def rows(text: str, heading: str) -> list[list[str]]:
    """Cells of the first table below a heading, without the header row."""
    _, below = re.split(rf"^##+ {heading}", text, maxsplit=1, flags=re.MULTILINE)
    return first_table(below)[2:]


def first_table(text: str) -> list[list[str]]:
    outside = itertools.dropwhile(lambda line: not line.startswith("|"), text.splitlines())
    lines = itertools.takewhile(lambda line: line.startswith("|"), outside)
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]


def table(text: str, first_column: str) -> dict[str, str]:
    """The first two columns of the table whose first column has this name."""
    after = text.split(f"\n| {first_column} |", 1)[1]
    return {row[0]: row[1] for row in first_table("| |" + after)[2:]}


def content_of(frame: bytes) -> bytes:
    """Unstuff a frame and check its CRC as the document describes."""
    assert frame[0] == frame[-1] == 0x7E
    content = frame[1:-1].replace(b"\x7d\x5e", b"\x7e").replace(b"\x7d\x5d", b"\x7d")
    assert zlib.crc32(content[:-4]) == int.from_bytes(content[-4:], "big")
    return content[:-4]


def decoded(content: bytes, layout: list[list[str]]) -> dict[str, float | bytes]:
    values: dict[str, float | bytes] = {}
    end = 0
    for offset, size, field, unit, _ in layout:
        assert int(offset) == end
        length = int(values["length"]) if size == "length" else int(size)
        piece = content[end : end + length]
        scale = float(unit.split()[0]) if unit else 1
        values[field] = piece if size == "length" else int.from_bytes(piece, "big") * scale
        end += length
    assert end == len(content)
    return values


def tag_of(example: Fields) -> TagTelegram:
    return TagTelegram(
        sequence=int(example["sequence"]),
        tag_id=int(example["tag_id"]),
        kind=TagKind[example["kind"]],
        stamp_ms=float(example["stamp_ms"]),
        sent_ms=float(example["sent_ms"]),
        pulses=int(example["pulses"]),
        payload=bytes.fromhex(example["payload"]),
    )


def health_of(example: Fields) -> HealthTelegram:
    return HealthTelegram(
        sequence=int(example["sequence"]),
        sent_ms=float(example["sent_ms"]),
        antenna_ok=example["antenna_ok"] == "1",
        telegrams_read=int(example["telegrams_read"]),
        crc_errors=int(example["crc_errors"]),
        uptime_s=int(example["uptime_s"]),
    )


@pytest.mark.parametrize(
    "sent",
    [
        *(pytest.param((tag_of(e), e["frame"]), id="tag") for e in examples(SERIAL, "TagTelegram")),
        *(
            pytest.param((health_of(e), e["frame"]), id="health")
            for e in examples(SERIAL, "HealthTelegram")
        ),
    ],
)
def test_the_code_sends_the_example_frames(
    sent: tuple[TagTelegram | HealthTelegram, str],
) -> None:
    assert telegram.encode(sent[0]).hex(" ") == sent[1]


@pytest.mark.parametrize(
    ("kind", "heading"),
    [("TagTelegram", "Tag telegram"), ("HealthTelegram", "Health telegram")],
)
def test_the_tables_alone_decode_the_example_frames(kind: str, heading: str) -> None:
    kinds = table(SERIAL, "kind")
    for example in examples(SERIAL, kind):
        values = decoded(content_of(bytes.fromhex(example["frame"])), rows(SERIAL, heading))
        assert values["version"] == 1
        for field, text in example.items():
            if field == "kind":
                assert kinds[str(int(values[field]))] == text
            elif field == "payload":
                assert values[field] == bytes.fromhex(text)
            elif field != "frame":
                assert values[field] == pytest.approx(float(text))


def test_the_serial_document_names_the_constants() -> None:
    constants = table(SERIAL, "constant")

    assert int(constants["bits per second"]) == serial_line.BAUD == inproc_line.BAUD
    assert int(constants["longest payload, bytes"]) == telegram.MAX_PAYLOAD_BYTES
    assert int(constants["longest frame on the line, bytes"]) == telegram.MAX_FRAME_BYTES
    assert float(constants["health telegram every, s"]) == telegram.HEALTH_PERIOD_S
    assert table(SERIAL, "kind") == {str(c): k.name for k, c in telegram.KIND_CODES.items()}


def test_the_serial_document_names_every_reason() -> None:
    assert set(table(SERIAL, "reason")) == {reason.value for reason in TornReason}


MESSAGES: dict[str, type[Message]] = {
    kind.__name__: kind for kind in (PositionReport, MovementAuthority, TrainStatus, TrainOrders)
}


def message_of(kind: str, example: Fields) -> Message:
    """The message of a written example; every field except the payload is JSON."""
    outside = ("payload", "database")
    values = {name: json.loads(text) for name, text in example.items() if name not in outside}
    if "restrictions" in values:
        values["restrictions"] = tuple(SpeedRestriction(*each) for each in values["restrictions"])
    return MESSAGES[kind](**values)


@pytest.mark.parametrize("kind", MESSAGES)
def test_the_code_sends_the_example_messages(kind: str) -> None:
    (example,) = examples(RADIO, kind)

    sent = codec.pack(message_of(kind, example), database=int(example["database"]))
    assert sent.hex(" ") == example["payload"]


@pytest.mark.parametrize(
    ("kind", "code", "sender", "receiver"),
    [
        ("PositionReport", 1, "train", "destination"),
        ("MovementAuthority", 2, "source", "train"),
        ("TrainStatus", 3, "train", "destination"),
        ("TrainOrders", 4, "source", "train"),
    ],
)
def test_the_tables_alone_decode_the_example_messages(
    kind: str, code: int, sender: str, receiver: str
) -> None:
    (example,) = examples(RADIO, kind)
    payload = bytes.fromhex(example["payload"])
    (key,) = re.findall(r"```bench-key\n([0-9a-f]+)\n```", RADIO)
    layout = [[*row[:3], "", row[3]] for row in rows(RADIO, "Envelope")]
    header_bytes = sum(int(row[1]) for row in layout)

    header = decoded(payload[:header_bytes], layout)
    body = msgspec.msgpack.decode(payload[header_bytes:-16])
    fields = dict(zip((row[0] for row in rows(RADIO, f"{kind},")), body, strict=True))

    assert (
        payload[-16:] == hmac.new(bytes.fromhex(key), payload[:-16], hashlib.sha256).digest()[:16]
    )
    key_id, version = divmod(int(header["version and key"]), 16)
    assert (version, key_id, header["type"]) == (codec.VERSION, 0, code)
    assert f"{code} {kind}" in next(row[3] for row in rows(RADIO, "Envelope") if row[2] == "type")
    assert (header["source"], header["destination"]) == (
        int(example[sender]),
        int(example[receiver]),
    )
    said = {**header, **fields}
    for field, text in example.items():
        if field not in ("payload", sender, receiver):
            assert str(said[field]).lower() == text


def test_the_radio_document_names_every_reason() -> None:
    named = {
        reason.strip()
        for row in rows(RADIO, "Threats")
        for reason in row[2].split(",")
        if reason.strip()
    }

    assert named == {reason.value for reason in RefusedReason}


def test_the_radio_document_has_the_keys_endpoint_and_limits() -> None:
    (block,) = re.findall(
        r"```keys florence, train 7, source 0, area 1\n(.*?)```", RADIO, re.DOTALL
    )

    assert block.split() == [
        keys.report("florence", 7),
        keys.reports("florence"),
        keys.authority("florence", 0, 7),
        keys.authorities("florence", 7),
        keys.status("florence", 7),
        keys.statuses("florence"),
        keys.order("florence", 0, 7),
        keys.orders("florence", 7),
    ]
    assert f"`{DEFAULT_ENDPOINT}`" in RADIO
    assert f"over {codec.MAX_BYTES} bytes" in RADIO
    assert f"| 0 | 1 | version and key | {codec.VERSION} in the lower four bits;" in RADIO
    assert f"at most {RESTRICTIONS_MAX}, each" in RADIO
    assert f"newest {INBOX_MESSAGES} messages" in RADIO
    assert INBOX_MESSAGES == ZENOH_INBOX_MESSAGES
