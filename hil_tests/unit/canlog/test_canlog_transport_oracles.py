"""ISO-TP and UDS agree with can-isotp and udsoncan, which know the standards independently."""

import inspect
import re
import warnings
from collections.abc import Sequence
from typing import Any

import isotp
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from udsoncan import services
from udsoncan.Request import Request
from udsoncan.Response import Response
from udsoncan.ResponseCode import ResponseCode
from udsoncan.services.ECUReset import ECUReset
from udsoncan.services.ReadDataByIdentifier import ReadDataByIdentifier
from udsoncan.services.RoutineControl import RoutineControl
from udsoncan.services.TesterPresent import TesterPresent

from canlog import Frames
from canlog.frames import EXTENDED, FD
from canlog.rows import from_rows
from canlog.transport.messages import TransportStatus
from canlog.transport.names import REFUSALS, SERVICES, uds_text
from canlog.transport.reassembly import Reassembler, TransportOptions

Wire = list[isotp.CanMessage]
MODES: dict[str, tuple[Any, dict[str, Any]]] = {
    "normal": (isotp.AddressingMode.Normal_11bits, {"txid": 0x7E0, "rxid": 0x7E8}),
    "fixed": (
        isotp.AddressingMode.NormalFixed_29bits,
        {"source_address": 0xF1, "target_address": 0x10},
    ),
    "extended": (
        isotp.AddressingMode.Extended_11bits,
        {"txid": 0x123, "rxid": 0x124, "source_address": 0x55, "target_address": 0xAA},
    ),
}
OPTIONS = {
    "normal": TransportOptions(),
    "fixed": TransportOptions(),
    "extended": TransportOptions(isotp_keys=(0x123,), address_bytes=1),
}


def sent(mode: str, payloads: Sequence[bytes], **params: Any) -> Wire:
    """Let can-isotp send messages; the receiver agrees to each first frame."""
    kind, names = MODES[mode]
    wire, answers = list[isotp.CanMessage](), list[isotp.CanMessage]()
    sender = isotp.TransportLayerLogic(
        rxfn=lambda timeout: answers.pop() if answers else None,
        txfn=wire.append,
        address=isotp.Address(kind, **names),
        params={"stmin": 0, "blocksize": 0, **params},
    )
    other = isotp.Address(kind, **swapped(names))
    prefix = other.get_tx_payload_prefix()
    agreement = isotp.CanMessage(
        arbitration_id=other.get_tx_arbitration_id(),
        data=prefix + bytes([0x30, 0, 0]),
        extended_id=other.is_tx_29bits(),
    )
    for each in payloads:
        sender.send(each)
        while sender.transmitting():
            before = len(wire)
            sender.process(rx_timeout=0)
            if any(frame.data[len(prefix)] >> 4 == 1 for frame in wire[before:]):
                answers.append(agreement)
    return wire


def swapped(names: dict[str, Any]) -> dict[str, Any]:
    pairs = {"txid": "rxid", "rxid": "txid", "source_address": "target_address",
             "target_address": "source_address"}  # fmt: skip
    return {pairs[name]: value for name, value in names.items()}


def framed(wire: Wire) -> Frames:
    rows = [
        (
            at * 1_000_000,
            each.arbitration_id,
            (EXTENDED if each.is_extended_id else 0) | (FD if each.is_fd else 0),
            "can0",
            bytes(each.data),
        )
        for at, each in enumerate(wire)
    ]
    return from_rows(rows)


def reassembled(wire: Wire, options: TransportOptions) -> list[bytes]:
    reassembler = Reassembler(options)
    parts = [*reassembler.feed(framed(wire)), *reassembler.finish()]
    return [
        part.payload(at)
        for part in parts
        for at in range(len(part))
        if part.status[at] == TransportStatus.WHOLE
    ]


def received(mode: str, wire: Wire) -> list[bytes]:
    """Let can-isotp receive the frames."""
    kind, names = MODES[mode]
    queue, found = list(wire), list[bytes]()
    receiver = isotp.TransportLayerLogic(
        rxfn=lambda timeout: queue.pop(0) if queue else None,
        txfn=lambda message: None,
        address=isotp.Address(kind, **swapped(names)),
        params={"max_frame_size": 1 << 20, "rx_consecutive_frame_timeout": 60_000},
    )
    while queue:
        receiver.process(rx_timeout=0)
        while receiver.available():
            found.append(bytes(receiver.recv() or b""))
    return found


@pytest.mark.parametrize("mode", MODES)
@given(
    payloads=st.lists(st.binary(min_size=1, max_size=200), min_size=1, max_size=3),
    padding=st.sampled_from([None, 0xCC]),
)
@settings(max_examples=15, deadline=None)
def test_what_can_isotp_sends_is_put_together(
    mode: str, payloads: list[bytes], padding: int | None
) -> None:
    wire = sent(mode, payloads, tx_padding=padding)

    assert reassembled(wire, OPTIONS[mode]) == payloads


@given(payloads=st.lists(st.binary(min_size=1, max_size=500), min_size=1, max_size=3))
@settings(max_examples=15, deadline=None)
def test_what_can_isotp_sends_on_can_fd_is_put_together(payloads: list[bytes]) -> None:
    wire = sent("normal", payloads, tx_data_length=64, can_fd=True)

    assert reassembled(wire, OPTIONS["normal"]) == payloads


@given(
    payloads=st.lists(st.binary(min_size=1, max_size=60), min_size=1, max_size=4),
    faults=st.lists(
        st.tuples(st.sampled_from(["drop", "twice", "swap"]), st.integers(0, 40)), max_size=4
    ),
)
@settings(max_examples=60, deadline=None)
def test_of_a_disturbed_bus_the_same_messages_are_whole(
    payloads: list[bytes], faults: list[tuple[str, int]]
) -> None:
    wire = sent("normal", payloads)
    for kind, at in faults:
        if at + 1 >= len(wire):
            continue
        if kind == "drop":
            del wire[at]
        elif kind == "twice":
            wire.insert(at, wire[at])
        else:
            wire[at], wire[at + 1] = wire[at + 1], wire[at]

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        wanted = received("normal", wire)

    assert reassembled(wire, OPTIONS["normal"]) == wanted


def plain(name: str) -> str:
    return re.sub(r"[^a-z0-9]", "", name.lower())


def test_services_and_refusals_have_the_names_of_udsoncan() -> None:
    known = {
        each._sid: name
        for name, each in inspect.getmembers(services, inspect.isclass)
        if hasattr(each, "_sid")
    }
    assert {code: SERVICES.get(code) for code in known} == known

    codes = {value: name for name, value in vars(ResponseCode).items() if isinstance(value, int)}
    assert {plain(REFUSALS[code]) for code in REFUSALS} == {plain(codes[code]) for code in REFUSALS}


@given(
    service=st.sampled_from([ReadDataByIdentifier, ECUReset, TesterPresent, RoutineControl]),
    code=st.sampled_from(sorted(REFUSALS)),
    data=st.binary(min_size=2, max_size=8),
)
@settings(max_examples=40, deadline=None)
def test_requests_answers_and_refusals_of_udsoncan_are_named(
    service: Any, code: int, data: bytes
) -> None:
    name = service.__name__
    subfunction = data[0] & 0x7F if service.use_subfunction() else None
    request = Request(service, subfunction=subfunction, data=data).get_payload()
    good = Response(service, code=0, data=data).get_payload()
    bad = Response(service, code=code).get_payload()

    assert uds_text(request).startswith(name)
    assert uds_text(good).startswith(f"{name} response")
    assert uds_text(bad) == f"{name} refused: {REFUSALS[code]}"
