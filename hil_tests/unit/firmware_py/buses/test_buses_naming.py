"""Buses by name: what a user may write, and how `auto` is resolved."""

import socket
import struct
import tempfile
from collections.abc import Iterator

import pytest

import firmware_py.buses
from firmware_py.buses import (
    BusError,
    BusKind,
    BusSpec,
    is_virtual,
    open_can,
    parse_spec,
    resolve_auto,
)
from firmware_py.buses.interfaces import Interface, link_request, look_up, parse_link
from firmware_py.clock.clock import LockstepClock

VCAN = Interface(is_can=True, is_up=True, kind="vcan")
HARDWARE = Interface(is_can=True, is_up=True, kind="can")


@pytest.fixture(autouse=True)
def bench_of_its_own(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    with tempfile.TemporaryDirectory() as folder:
        monkeypatch.setenv("XDG_RUNTIME_DIR", folder)
        yield


@pytest.fixture
def interfaces(monkeypatch: pytest.MonkeyPatch) -> dict[str, Interface]:
    """Simulated interfaces that replace those of the machine."""
    known: dict[str, Interface] = {}
    monkeypatch.setattr(firmware_py.buses, "look_up", known.get)
    return known


@pytest.mark.parametrize(
    ("text", "kind"), [("socketcan:can0", BusKind.SOCKETCAN), ("embedded:can0", BusKind.EMBEDDED)]
)
def test_kind_and_name_are_separated(text: str, kind: BusKind) -> None:
    assert parse_spec(text) == BusSpec(kind, "can0")
    assert str(parse_spec(text)) == text


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("sokcetcan:vcan0", "bus 'sokcetcan:vcan0': unknown kind; nearest valid: socketcan"),
        ("embeded:vcan0", "nearest valid: embedded"),
        ("xyz:vcan0", "unknown kind; valid: socketcan, embedded"),
        ("vcan0", "no kind; write socketcan:vcan0 or embedded:vcan0"),
        ("", "no kind"),
        ("socketcan:", "name '': 1 to 15"),
        ("socketcan:../up", "name '../up'"),
        ("embedded:a:b", "name 'a:b'"),
        ("embedded:" + "a" * 16, "1 to 15"),
    ],
)
def test_an_invalid_bus_is_refused_with_the_valid_forms(text: str, words: str) -> None:
    with pytest.raises(BusError) as caught:
        parse_spec(text)
    assert words in str(caught.value)
    with pytest.raises(BusError):
        open_can(text, clock=LockstepClock(), node="vobc")
    with pytest.raises(BusError):
        is_virtual(text)


def test_a_missing_hub_is_reported_with_the_remedy() -> None:
    with pytest.raises(BusError, match=r"embedded:vcan0: no hub .* start it with `vcan up vcan0`"):
        open_can("embedded:vcan0", clock=LockstepClock(), node="vobc")


@pytest.mark.parametrize("node", ["", "n" * 65])
def test_a_node_name_that_the_hub_cannot_store_is_refused(node: str) -> None:
    with pytest.raises(BusError, match="node name"):
        open_can("embedded:vcan0", clock=LockstepClock(), node=node)


def test_auto_chooses_the_kernels_interface_when_it_is_up(interfaces: dict[str, Interface]) -> None:
    interfaces["vcan0"] = VCAN

    assert resolve_auto("vcan0").spec == "socketcan:vcan0"


@pytest.mark.parametrize(
    ("found", "words"),
    [
        (None, "the kernel has no interface vcan0, and no hub of that name runs"),
        (Interface(is_can=True, is_up=False, kind="vcan"), "interface vcan0 is down"),
        (Interface(is_can=False, is_up=True, kind=""), "interface vcan0 is no CAN interface"),
    ],
)
def test_auto_names_the_reason_when_there_is_no_bus(
    interfaces: dict[str, Interface], found: Interface | None, words: str
) -> None:
    if found is not None:
        interfaces["vcan0"] = found

    choice = resolve_auto("vcan0")

    assert choice.spec is None
    assert words in choice.reason


def test_only_known_virtual_interfaces_count_as_virtual(interfaces: dict[str, Interface]) -> None:
    interfaces |= {
        "vcan0": VCAN,
        "vxcan0": Interface(is_can=True, is_up=False, kind="vxcan"),
        "can0": HARDWARE,
        "slcan0": Interface(is_can=True, is_up=True, kind="slcan"),
        "usb0": Interface(is_can=True, is_up=True, kind=""),
    }

    virtual = {name for name in interfaces if is_virtual(f"socketcan:{name}")}

    assert virtual == {"vcan0", "vxcan0"}
    assert not is_virtual("socketcan:missing0")
    assert is_virtual("embedded:anything")


def attribute(kind: int, value: bytes) -> bytes:
    return struct.pack("=HH", 4 + len(value), kind) + value + bytes(-len(value) % 4)


def link_answer(hardware: int, flags: int, attributes: bytes, kind: int = 16) -> bytes:
    """A netlink answer in the layout of the kernel: header, ifinfomsg, attributes."""
    body = struct.pack("=BBHiII", 0, 0, hardware, 3, flags, 0) + attributes
    return struct.pack("=IHHII", 16 + len(body), kind, 0, 1, 0) + body


@pytest.mark.parametrize(
    ("answer", "expected"),
    [
        (
            link_answer(
                280, 0x100C1, attribute(3, b"vcan0\0") + attribute(18, attribute(1, b"vcan\0"))
            ),
            Interface(is_can=True, is_up=True, kind="vcan"),
        ),
        # Newer kernels set the nested flag.
        (
            link_answer(
                280, 0x80, attribute(18 | 0x8000, attribute(1, b"can") + attribute(2, b"x"))
            ),
            Interface(is_can=True, is_up=False, kind="can"),
        ),
        (link_answer(1, 0x1043, b""), Interface(is_can=False, is_up=True, kind="")),
        # ENODEV
        (struct.pack("=IHHIIi", 36, 2, 0, 1, 0, -19) + bytes(16), None),
        (b"", None),
        (link_answer(280, 1, b"")[:20], None),
        (link_answer(280, 1, b"\0\0\0\0"), Interface(is_can=True, is_up=True, kind="")),
        (link_answer(280, 1, b"\x40\0\x12\0\x01"), Interface(is_can=True, is_up=True, kind="")),
    ],
)
def test_the_kernels_answer_is_decoded(answer: bytes, expected: Interface | None) -> None:
    assert parse_link(answer) == expected


def test_the_question_names_the_interface() -> None:
    request = link_request("vcan0")

    assert struct.unpack_from("=IHH", request) == (len(request), 18, 1)
    assert request[32:] == attribute(3, b"vcan0\0")


def test_this_machines_own_interfaces_are_found() -> None:
    """Netlink must know every name that the system lists, and no name that cannot exist."""
    names = [name for _, name in socket.if_nameindex()]
    assert names

    assert all(look_up(name) is not None for name in names)
    assert look_up("not-there-0") is None
