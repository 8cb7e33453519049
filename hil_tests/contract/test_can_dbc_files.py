"""The shipped DBC files load cleanly, agree with each other, and hold the attributes that tools
need."""

import logging
import math
import subprocess
import sys
import warnings
from collections.abc import Iterator
from importlib import resources
from typing import Any

import cantools.database
import pytest
from cantools.database.can import Database, Message

from can_dbc import binding
from can_dbc.alarms import TrainAlarms
from can_dbc.analogue import AnalogueCommand
from can_dbc.brake import BrakeCommand, BrakeStatus
from can_dbc.cab import Desk
from can_dbc.diagnostics import EMERGENCIES, HEARTBEATS, TcmsStatus, TimeOfDay
from can_dbc.doors import DoorCars, DoorCommand, DoorStatus
from can_dbc.energy import EnergyMeter, LineSupply
from can_dbc.merged import merged
from can_dbc.nodes import Node
from can_dbc.odometer import ColdMovement, Doppler, Imu, Tacho
from can_dbc.tags import TagReaderHealth
from can_dbc.traction import TractionCommand, TractionStatus
from can_dbc.vobc import (
    Cause,
    ReasonCode,
    VobcEvent,
    VobcLimits,
    VobcMode,
    VobcMotion,
    VobcPosition,
    VobcStatus,
    VobcSupervision,
    VobcTarget,
)

FILES = sorted(
    entry.name for entry in resources.files("can_dbc").iterdir() if entry.name.endswith(".dbc")
)

AGREED = [
    (BrakeCommand, "VOBC", 0x101, 50),
    (TractionCommand, "VOBC", 0x103, 50),
    (DoorCommand, "VOBC", 0x105, 100),
    (AnalogueCommand, "VOBC", 0x107, 50),
    (DoorCars, "VOBC", 0x108, 100),
    (VobcStatus, "VOBC", 0x181, 50),
    (BrakeStatus, "BCU", 0x182, 50),
    (TractionStatus, "TCU", 0x183, 50),
    (DoorStatus, "DCU", 0x184, 100),
    (Tacho, "ODO", 0x185, 20),
    (TagReaderHealth, "BTM", 0x186, 250),
    (Desk, "DESK", 0x187, 100),
    (LineSupply, "HVB", 0x188, 100),
    (TcmsStatus, "TCMS", 0x189, 250),
    (TrainAlarms, "TCMS", 0x18A, 100),
    (VobcMotion, "VOBC", 0x281, 100),
    (Doppler, "ODO", 0x285, 50),
    (EnergyMeter, "HVB", 0x288, 1000),
    (VobcMode, "VOBC", 0x301, 100),
    (VobcPosition, "VOBC", 0x381, 100),
    (Imu, "ODO", 0x385, 50),
    (ColdMovement, "ODO", 0x405, 500),
    (VobcLimits, "VOBC", 0x401, 100),
    (VobcTarget, "VOBC", 0x481, 200),
    (VobcSupervision, "VOBC", 0x501, 100),
    (VobcEvent, "VOBC", 0x581, 0),
    (TimeOfDay, "TCMS", 0x100, 1000),
    *((HEARTBEATS[node], node.name, 0x700 + node, 1000) for node in Node),
    *((EMERGENCIES[node], node.name, 0x080 + node, 0) for node in Node),
]
"""Class, sender, identifier and period in ms, as the subsystems agreed on them."""

UNPROTECTED = {LineSupply, EnergyMeter, TcmsStatus, TimeOfDay, VobcEvent} | {
    *HEARTBEATS.values(),
    *EMERGENCIES.values(),
}


def load(*names: str) -> Database:
    database = Database(strict=True)
    for name in names:
        with resources.as_file(resources.files("can_dbc") / name) as path:
            database.add_dbc_file(path)
    return database


def all_messages() -> list[Message]:
    return load(*FILES).messages


@pytest.fixture(autouse=True)
def _a_warning_is_an_error(caplog: pytest.LogCaptureFixture) -> Iterator[None]:
    with warnings.catch_warnings(), caplog.at_level(logging.INFO, logger="cantools"):
        warnings.simplefilter("error")
        yield
    assert caplog.records == []


@pytest.mark.parametrize("name", FILES)
def test_each_file_loads_alone_without_a_warning(name: str) -> None:
    with resources.as_file(resources.files("can_dbc") / name) as path:
        database = cantools.database.load_file(path, strict=True)

    assert isinstance(database, Database)
    assert database.messages


@pytest.mark.parametrize("order", [FILES, FILES[::-1]])
def test_all_files_load_into_one_database(order: list[str]) -> None:
    database = load(*order)

    assert len({message.frame_id for message in database.messages}) == len(database.messages)
    assert len({message.name for message in database.messages}) == len(database.messages)


def test_a_reason_that_is_the_cause_of_an_emergency_has_its_number() -> None:
    assert {name: cause.value for name, cause in Cause.__members__.items()}.items() <= {
        name: reason.value for name, reason in ReasonCode.__members__.items()
    }.items()


def test_every_file_has_a_module_and_every_message_a_class() -> None:
    bound = {
        message.name for kind in binding.kinds() for message in binding.binding_of(kind).messages
    }

    assert bound == {message.name for message in all_messages()}


@pytest.mark.parametrize(("kind", "sender", "can_id", "period_ms"), AGREED)
def test_identifiers_senders_and_periods_are_as_agreed(
    kind: type[Any], sender: str, can_id: int, period_ms: int
) -> None:
    assert binding.can_id(kind) == can_id
    assert binding.sender(kind) == sender
    assert binding.period_s(kind) == period_ms / 1000.0


def test_the_agreement_covers_every_class() -> None:
    assert set(binding.kinds()) == {kind for kind, *_ in AGREED}


@pytest.mark.parametrize("kind", [kind for kind, *_ in AGREED])
def test_every_message_except_energy_and_diagnostics_is_protected(kind: type[Any]) -> None:
    names = [signal.name for signal in binding.message(kind).signals]

    assert names[-2:] == ["alive_counter", "crc16"] or kind in UNPROTECTED
    assert ("crc16" in names) == (kind not in UNPROTECTED)
    assert binding.is_vital(kind) == (
        kind in {BrakeCommand, TractionCommand, DoorCommand, DoorCars}
    )


@pytest.mark.parametrize("kind", [kind for kind, *_ in AGREED])
def test_a_timeout_is_at_least_three_periods(kind: type[Any]) -> None:
    timeout_s = binding.timeout_s(kind)

    assert math.isinf(timeout_s) or round(timeout_s * 1000) >= 3 * round(
        binding.period_s(kind) * 1000
    )
    assert math.isinf(timeout_s) == (binding.period_s(kind) == 0.0)


def test_data_ids_are_unique_among_all_files_twins_included() -> None:
    ids = [
        message.dbc.attributes["SafetyDataId"].value
        for message in all_messages()
        if message.dbc is not None and "SafetyDataId" in message.dbc.attributes
    ]

    assert len(ids) == 26
    assert len(set(ids)) == len(ids)


@pytest.mark.parametrize("message", all_messages(), ids=lambda message: str(message.name))
def test_a_message_documents_sender_content_and_period(message: Message) -> None:
    node_names = {node.name for node in Node}

    assert message.comment
    assert set(message.senders) <= node_names
    event = message.name.startswith("EMCY") or message.name == "VOBC_EVENT"
    assert message.send_type == ("spontaneous" if event else "cyclic")
    for signal in message.signals:
        assert signal.comment, signal.name
        assert set(signal.receivers) <= node_names
        assert signal.receivers, signal.name
        assert signal.minimum is not None, signal.name
        assert signal.maximum is not None, signal.name


@pytest.mark.parametrize("message", all_messages(), ids=lambda message: str(message.name))
def test_start_values_are_encodable_and_permit_nothing(message: Message) -> None:
    """A tool that sends start values must not release a brake or open a door."""
    start = {signal.name: signal.raw_initial or 0 for signal in message.signals}

    decoded = message.decode(message.encode(start, scaling=False))

    assert isinstance(decoded, dict)
    assert "TRUE" not in [str(value) for value in decoded.values()]


def test_node_numbers_match_the_node_enumeration() -> None:
    for name in FILES:
        assert [node.name for node in load(name).nodes] == [node.name for node in Node]
    numbers = {
        node.name: node.dbc.attributes["NodeId"].value for node in load("diagnostics.dbc").nodes
    }
    assert numbers == {node.name: node.value for node in Node}
    assert all(node.comment for node in load("diagnostics.dbc").nodes)


def test_heartbeat_and_emergency_have_the_layout_of_canopen() -> None:
    """CiA 301: EMCY holds code, register and five bytes of the manufacturer; TIME has 28 + 4 +
    16 bits."""
    database = load("diagnostics.dbc")

    places = {
        message.name: [(signal.start, signal.length) for signal in message.signals]
        for message in database.messages
    }

    for node in Node:
        assert places[f"HEARTBEAT_{node.name}"] == [(0, 8)]
        assert places[f"EMCY_{node.name}"] == [(0, 16), (16, 8), (24, 40)]
    assert places["TIME_OF_DAY"] == [(0, 28), (32, 16)]
    assert database.get_message_by_name("TIME_OF_DAY").length == 6


def test_the_merged_file_equals_the_single_files() -> None:
    database = Database(strict=True)

    database.add_dbc_string(merged())

    parts = load(*FILES)
    assert {message.name for message in database.messages} == {
        message.name for message in parts.messages
    }
    assert [(node.name, node.comment) for node in database.nodes] == [
        (node.name, node.comment) for node in load("diagnostics.dbc").nodes
    ]
    for message in parts.messages:
        assert facts_of(database.get_message_by_name(message.name)) == facts_of(message)


def facts_of(message: Message) -> list[object]:
    assert message.dbc is not None
    attributes = {name: each.value for name, each in message.dbc.attributes.items()}
    facts: list[object] = [message.frame_id, message.length, message.senders, message.cycle_time]
    facts += [message.send_type, message.comment, attributes]
    for signal in message.signals:
        facts += [signal.name, signal.start, signal.length, signal.is_signed, signal.scale]
        facts += [signal.offset, signal.minimum, signal.maximum, signal.unit, signal.comment]
        facts += [signal.choices, signal.raw_initial, signal.receivers]
    return facts


def test_the_merged_file_comes_from_the_command_line() -> None:
    done = subprocess.run(
        [sys.executable, "-m", "can_dbc.merged"], capture_output=True, text=True, check=True
    )

    assert done.stdout == merged()
