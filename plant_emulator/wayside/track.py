"""Track status for each area's master: occupied sections, restrictions, closed stretches."""

from collections.abc import Collection, Mapping

from firmware_py.trackdb.areas import AreaMap, TrackSection
from zenoh_config.messages import WAYSIDE, SpeedRestriction
from zenoh_config.t2t import (
    LAST_TRAIN,
    Heartbeat,
    SectionState,
    T2tMessage,
    TrackStatus,
)
from zenoh_config.timers import NS_PER_MS, LineTimers


class WaysideTrack:
    """Answers heartbeats.

    Each answer echoes one, so that the master knows its age.

    It answers every master, even an outdated one, because the track status holds for every
    receiver.
    """

    def __init__(self, timers: LineTimers, line: AreaMap, *, boot: int, start_ns: int) -> None:
        self.restrictions: tuple[SpeedRestriction, ...] = ()
        self.closed: tuple[SpeedRestriction, ...] = ()
        self._line, self._boot = line, boot
        self._period_ns = timers.heartbeat_ms * NS_PER_MS
        self._masters: dict[int, Heartbeat] = {}
        """By area, the newest heartbeat of the highest term."""
        self._known = {area.number for area in line.areas}
        self._reported_range = {area: _span(line, area) for area in self._known}
        self._sequence = 0

    def step(
        self,
        now_ns: int,
        heard: tuple[T2tMessage, ...],
        *,
        axles: Mapping[int, int],
        disturbed: Collection[int] = (),
    ) -> tuple[T2tMessage, ...]:
        """Return one status for each master that sent a newer heartbeat.

        Args:
            axles: number in each section by its number; 0 for sections not listed.
            disturbed: sections with an unreliable count; they are reported as occupied.
        """
        answered = []
        for message in heard:
            if not isinstance(message, Heartbeat) or message.area not in self._known:
                continue
            if not 0 < message.source <= LAST_TRAIN:
                continue
            newest = self._masters.get(message.area)
            if newest is not None and _order(message) <= _order(newest):
                continue
            self._masters[message.area] = message
            answered.append(message.area)
        return tuple(
            [self._status(now_ns, area, axles, disturbed) for area in dict.fromkeys(answered)]
        )

    def _reported_sections(
        self, area: int, axles: Mapping[int, int], disturbed: Collection[int]
    ) -> tuple[TrackSection, ...]:
        """Return the sections to report.

        Beyond the borders they continue while occupied, so that no train is reported in part: the
        master could not account for its axles.
        """
        every, (first, last) = self._line.sections, self._reported_range[area]
        if first > last:
            return ()

        def occupied(at: int) -> bool:
            return axles.get(every[at].number, 0) != 0 or every[at].number in disturbed

        while first > 0 and occupied(first):
            first -= 1
        while last + 1 < len(every) and occupied(last):
            last += 1
        return every[first : last + 1]

    def _status(
        self, now_ns: int, area: int, axles: Mapping[int, int], disturbed: Collection[int]
    ) -> TrackStatus:
        self._sequence += 1
        heartbeat = self._masters[area]
        states = [
            SectionState(
                each.number,
                axles.get(each.number, 0) != 0 or each.number in disturbed,
                0 if each.number in disturbed else max(0, axles.get(each.number, 0)),
            )
            for each in self._reported_sections(area, axles, disturbed)
        ]
        return TrackStatus(
            WAYSIDE,
            heartbeat.source,
            area,
            heartbeat.term,
            self._boot,
            self._sequence,
            now_ns,
            heartbeat.stamp_ns,
            tuple(states),
            self.restrictions,
            self.closed,
        )


def _order(heartbeat: Heartbeat) -> tuple[int, int, int]:
    return (heartbeat.term, heartbeat.boot, heartbeat.sequence)


def _span(line: AreaMap, area: int) -> tuple[int, int]:
    """Return the first and last section reported to an area's master; (0, -1) if there is none."""
    told = line.sections_told(area)
    return (line.sections.index(told[0]), line.sections.index(told[-1])) if told else (0, -1)
