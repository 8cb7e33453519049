"""Keys of train-to-train messages: `m/<line>/w/<writer>/<kind>/<area>/<reader>`, writer first."""

from collections.abc import Iterable
from typing import Final

from zenoh_config.keys import line_chunk, statuses
from zenoh_config.messages import WAYSIDE
from zenoh_config.t2t import (
    BROADCAST,
    LAST_TRAIN,
    SUPERVISION,
    Admission,
    AreaAuthority,
    Heartbeat,
    LeaseAnswer,
    LeaseRequest,
    LineOrder,
    ObjectClaim,
    ObjectStatus,
    RosterAck,
    RosterCommit,
    StandbySync,
    SwitchStep,
    SyncAck,
    T2tMessage,
    TrackStatus,
    TrainReport,
)
from zenoh_config.t2t_supervision import Decree, LineState, Removal, RemovalAnswer

ADDRESS_DIGITS: Final = 5
"""Longest address in a key; a longer number is cut, as only messages to the user show it."""
PRESENT: Final = "up"
"""Last chunk of the liveliness token that a train's session declares."""
TO_ALL: Final = "all"
"""The reader's chunk of messages to all receivers of an area."""
CHUNKS: Final[dict[type[T2tMessage], str]] = {
    LeaseRequest: "acq",
    LeaseAnswer: "gr",
    Heartbeat: "hb",
    TrainReport: "tr",
    AreaAuthority: "aa",
    StandbySync: "sy",
    SyncAck: "sa",
    RosterCommit: "rc",
    RosterAck: "ra",
    SwitchStep: "sw",
    ObjectClaim: "cl",
    ObjectStatus: "os",
    TrackStatus: "tk",
    LineOrder: "lo",
    Admission: "ad",
    Decree: "de",
    LineState: "ls",
    Removal: "rm",
    RemovalAnswer: "rn",
}


def key_of(line: str, message: T2tMessage) -> str:
    """Key of a message; a reader refuses a message under another key."""
    reader = TO_ALL if message.destination == BROADCAST else str(message.destination)
    kind = CHUNKS[type(message)]
    return f"m/{line_chunk(line)}/w/{message.source}/{kind}/{message.area}/{reader}"


def writer_of(key: str) -> int | None:
    """Return the address of the writer in a message's key; None if it names none."""
    chunks = key.split("/")
    if len(chunks) < 4 or not (chunks[3].isascii() and chunks[3].isdecimal()):
        return None
    return int(chunks[3][:ADDRESS_DIGITS])


def sender_text(address: int | None) -> str:
    """Name of a sender for messages to the user."""
    if address is None:
        return "an unknown sender"
    if address == SUPERVISION:
        return "supervision"
    if 0 < address <= LAST_TRAIN:
        return f"train {address}"
    return "the wayside" if address == WAYSIDE else f"address {address}"


def token_of(line: str, train: int) -> str:
    """Liveliness token of a train's session.

    It does not prove that the train's program works, so only displays may use it.
    """
    return f"m/{line_chunk(line)}/w/{train}/{PRESENT}"


def tokens(line: str) -> str:
    """Key expression of all trains' tokens of a line."""
    return f"m/{line_chunk(line)}/w/*/{PRESENT}"


def train_of_token(key: str) -> int | None:
    """Return the train of a token; None if it is not the token of a train."""
    chunks = key.split("/")
    if len(chunks) != 5 or chunks[4] != PRESENT or not chunks[3].isdecimal():
        return None
    return int(chunks[3])


def of_train(line: str, train: int, areas: Iterable[int] = ()) -> tuple[str, ...]:
    """Subscriptions of a train: messages addressed to it, messages to all in its areas, and
    messages under its own address, which reveal another sender with that address.
    """
    kinds = (Heartbeat, TrainReport, SwitchStep, ObjectStatus)
    own = (
        LeaseAnswer,
        AreaAuthority,
        StandbySync,
        SyncAck,
        RosterAck,
        SwitchStep,
        TrackStatus,
        LineOrder,
        Admission,
        Removal,
    )
    root = f"m/{line_chunk(line)}/w"
    return (
        *_keys(line, own, str(train)),
        *[f"{root}/{train}/{CHUNKS[kind]}/*/{TO_ALL}" for kind in (Heartbeat, TrainReport)],
        *[f"{root}/*/{CHUNKS[kind]}/{area}/{TO_ALL}" for area in areas for kind in kinds],
    )


def of_arbiter(line: str, arbiter: int) -> tuple[str, ...]:
    """Subscriptions of an arbiter."""
    return _keys(line, (LeaseRequest, RosterCommit), str(arbiter))


def of_wayside(line: str) -> tuple[str, ...]:
    """Subscriptions of objects, track and centre."""
    return (
        *_keys(line, (Heartbeat,), TO_ALL),
        *_keys(line, (ObjectClaim, Decree), str(WAYSIDE)),
        statuses(line),
    )


def of_grants(line: str) -> tuple[str, ...]:
    """Subscriptions of objects and track, where arbiters are other programs: their answers."""
    return _keys(line, (LeaseAnswer,), "*")


def of_departures(line: str) -> tuple[str, ...]:
    """Subscriptions of a wayside that reports trains as gone."""
    answers = _keys(line, (RemovalAnswer,), str(SUPERVISION))
    return (*_keys(line, (Heartbeat,), TO_ALL), *answers)


def of_supervision(line: str) -> tuple[str, ...]:
    """Subscriptions of a display: masters, positions, authorities, reasons of waiting trains, and
    commands.
    """
    return (
        *_keys(line, (Heartbeat, TrainReport, ObjectStatus, LineState), TO_ALL),
        *_keys(line, (Admission, AreaAuthority), "*"),
        *_keys(line, (RemovalAnswer,), str(SUPERVISION)),
        statuses(line),
    )


def of_line(line: str) -> tuple[str, ...]:
    """Subscriptions of a recorder: everything."""
    return (f"m/{line_chunk(line)}/**",)


def _keys(line: str, kinds: Iterable[type[T2tMessage]], reader: str) -> tuple[str, ...]:
    return tuple([f"m/{line_chunk(line)}/w/*/{CHUNKS[kind]}/*/{reader}" for kind in kinds])
