"""Selects messages of a line's radio, and explains an empty selection."""

from collections.abc import Iterable, Iterator

from metro_hil.supervision.radio_log import Chosen, RadioEntry, RadioLogFilter
from plant_emulator.wayside.detection import Place
from zenoh_config.messages import Refused, RefusedReason


class RadioLogSelection:
    def __init__(self, choice: RadioLogFilter | None = None) -> None:
        self._choice = choice or RadioLogFilter()
        self._heard = self._passed = 0
        self._coded = self._foreign = 0
        """Number of messages with a safety code, which positions lack, and with a wrong safety
        code."""

    def pass_on(self, entries: Iterable[RadioEntry]) -> Iterator[Chosen]:
        start_s = None
        for entry in entries:
            start_s = entry.at_s if start_s is None else start_s
            self._count(entry)
            if self._choice.takes(entry, start_s):
                self._passed += 1
                yield Chosen(entry, start_s)

    def _count(self, entry: RadioEntry) -> None:
        heard = entry.heard
        self._heard += 1
        self._coded += not isinstance(heard, Place)
        self._foreign += isinstance(heard, Refused) and heard.reason is RefusedReason.WRONG_CODE

    def doubts(self, *, secured: bool) -> list[str]:
        """Return warnings about the messages so far.

        Args:
            secured: the key of a secured line was used.
        """
        said = []
        if not self._heard:
            said.append("no message")
        elif not self._passed:
            said.append(f"none of {self._heard} messages passes the filters")
        if self._foreign and self._foreign == self._coded:
            of = "a line other than that of --secure" if secured else "a secured line"
            remedy = "" if secured else "; use --secure FOLDER"
            said.append(f"all {self._foreign} safety codes are wrong, as of {of}{remedy}")
        return said
