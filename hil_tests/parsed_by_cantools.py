"""The messages of the shipped DBC files as cantools parses them, which judge our codec."""

import functools
from typing import Any

from cantools.database.can import Database, Message

from can_dbc import binding, dbc_file


@functools.cache
def shipped_database() -> Database:
    database = Database(strict=True)
    for name in dbc_file.names():
        database.add_dbc_string(dbc_file.text_of(name))
    return database


def message_of(kind: type[Any]) -> Message:
    return shipped_database().get_message_by_name(binding.message(kind).name)


def data_id_of(name: str) -> bytes:
    """The data id of a message as its CRC begins with it."""
    found = shipped_database().get_message_by_name(name).dbc
    assert found is not None
    return int(found.attributes["SafetyDataId"].value).to_bytes(2, "little")
