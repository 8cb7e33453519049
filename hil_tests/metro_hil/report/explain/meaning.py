"""Decodes the bytes behind an event: name and value of each signal."""

from typing import Final

from firmware_py.ports import CanFrame, RadioMessage, SerialChunk
from firmware_py.tag_reader.telegram import TelegramParser
from metro_hil.replay.meaning import chunk_words, frame_words, message_words
from metro_hil.report.explain.event_log import LoggedSource

TAG: Final = "tag telegram"
RADIO: Final = ("movement authority", "orders")


def source_words(source: LoggedSource) -> tuple[str, str]:
    """Name and values of an input, or why there are none."""
    if source.number is None:
        return source.source, "never received" if source.source != "clock" else ""
    if source.source == TAG:
        _, values = chunk_words(TelegramParser(), SerialChunk(0, source.payload))
        return f"tag {source.number}", values
    if source.source in RADIO:
        _, values = message_words(RadioMessage(0, "", source.payload))
        return f"{source.source} {source.number}", values
    return frame_words(CanFrame(0, source.number, source.payload))
