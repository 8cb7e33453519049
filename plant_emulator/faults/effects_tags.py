"""Faults of tags, their antenna and their reader."""

from collections.abc import Sequence
from typing import Final

import numpy as np

from firmware_py.trackdb import TagKind, TagSite
from plant_emulator.faults.declared_train import (
    AntennaDead,
    TagDisplaced,
    TagDuplicate,
    TagFalse,
    TagMissed,
)
from plant_emulator.faults.effects import Effect, SettingFault, SharedSetting
from plant_emulator.faults.plan import FaultPlan
from plant_emulator.sensors.tag_reader import FAR_NS, TagPass, TagReader
from plant_emulator.world import STEP_NS, World

NS_PER_S: Final = 1_000_000_000


class TagEffects:
    """Combines concurrent faults of tags.

    Offsets add; a dead antenna is hidden only if all its faults are hidden.
    """

    def __init__(self, world: World) -> None:
        self._world = world
        reader = world.tag_reader

        def kill(found: Sequence[AntennaDead]) -> None:
            reader.antenna_dead = bool(found)
            reader.fault_hidden = all(each.hidden for each in found)

        def displace(found: Sequence[TagDisplaced]) -> None:
            reader.displace(
                {
                    site.tag_id: sum(
                        each.offset_m for each in found if _concerns(each.tag_id, site.tag_id)
                    )
                    for site in reader.tags
                }
            )

        self._dead = SharedSetting[AntennaDead](kill)
        self._displaced = SharedSetting[TagDisplaced](displace)

    def of(self, plan: FaultPlan) -> Effect | None:
        """Return the effect of a tag fault; None for a fault of another place."""
        world, parameters = self._world, plan.parameters
        match parameters:
            case TagMissed():
                return UnreadTag(world.tag_reader, parameters, plan.generator(world.seed))
            case TagDuplicate():
                return Doubling(world, parameters, plan.generator(world.seed))
            case TagFalse():
                return Inventing(world, parameters, plan.generator(world.seed))
            case TagDisplaced():
                return SettingFault(plan.index, (self._displaced, parameters))
            case AntennaDead():
                return SettingFault(plan.index, (self._dead, parameters))
        return None


class UnreadTag:
    def __init__(
        self, reader: TagReader, parameters: TagMissed, generator: np.random.Generator
    ) -> None:
        self._reader, self._parameters, self._generator = reader, parameters, generator
        self.touched = 0
        """Number of tags that were not read."""

    def begin(self, now_ns: int) -> None:
        self._reader.judges.append(self._is_read)

    def end(self, now_ns: int) -> None:
        self._reader.judges.remove(self._is_read)

    def step(self, now_ns: int) -> bool:
        return False

    def _is_read(self, passed: TagPass) -> bool:
        if not _concerns(self._parameters.tag_id, passed.site.tag_id):
            return True
        read = self._generator.random() >= self._parameters.share_ratio
        self.touched += not read
        return bool(read)


class FalseReadings:
    """Adds readings of tags that did not pass the antenna."""

    def __init__(self, world: World, generator: np.random.Generator) -> None:
        self._world, self._generator = world, generator

    def read(self, site: TagSite, at_ns: int) -> None:
        """Read a tag as if it had been under the antenna at an instant of the plant's last step."""
        world, draws = self._world, self._generator
        sensors = world.train.sensors
        share_ratio = 1.0 - (world.now_ns - at_ns) / STEP_NS
        world.tag_reader.read(
            TagPass(
                site=site,
                true_ns=at_ns,
                stamp_ns=at_ns + round(sensors.tag_stamp_s.draw(draws) * NS_PER_S),
                pulses=world.tachos.pulses_a(share_ratio),
                due_ns=at_ns + round(sensors.tag_latency_s.draw(draws) * NS_PER_S),
            )
        )


class Doubling:
    """Repeats every reading that was made while the fault was active, even after its end."""

    def __init__(
        self, world: World, parameters: TagDuplicate, generator: np.random.Generator
    ) -> None:
        self._reader, self._parameters = world.tag_reader, parameters
        self._reading = FalseReadings(world, generator)
        self._gap_ns = round(parameters.gap_s * NS_PER_S)
        self._waiting: list[_Second] = []
        self.touched = 0
        """Number of second readings."""

    def begin(self, now_ns: int) -> None:
        self._reader.witnesses.append(self._see)

    def end(self, now_ns: int) -> None:
        self._reader.witnesses.remove(self._see)

    def step(self, now_ns: int) -> bool:
        waiting: list[_Second] = []
        for second in self._waiting:
            second.follow(now_ns, self._reader.antenna_m)
            if second.due_ns <= now_ns:
                self._reading.read(second.site, second.due_ns)
                self.touched += 1
            else:
                waiting.append(second)
        self._waiting = waiting
        return bool(waiting)

    def _see(self, passed: TagPass) -> None:
        tag_id = passed.site.tag_id
        if _concerns(self._parameters.tag_id, tag_id):
            soonest_ns, felt_m = passed.true_ns + self._gap_ns, self._reader.felt_m(tag_id)
            self._waiting.append(_Second(passed, soonest_ns, felt_m, self._parameters.gap_m))


class _Second:
    """A pending second reading.

    It is due when the delay is over and the antenna is far enough from the tag.
    """

    def __init__(self, first: TagPass, soonest_ns: int, felt_m: float, gap_m: float) -> None:
        self.site = first.site
        self.due_ns = FAR_NS
        self._soonest_ns, self._felt_m, self._gap_m = soonest_ns, felt_m, gap_m
        self._was_ns, self._was_off_m = first.true_ns, 0.0
        """Last instant and the antenna's distance from the tag at that instant."""

    def follow(self, now_ns: int, antenna_m: float) -> None:
        if self.due_ns < FAR_NS:
            return
        off_m, was_ns, was_off_m = abs(antenna_m - self._felt_m), self._was_ns, self._was_off_m
        self._was_ns, self._was_off_m = now_ns, off_m
        if off_m >= self._gap_m:
            ahead_m = self._gap_m - was_off_m
            share_ratio = ahead_m / (off_m - was_off_m) if ahead_m > 0.0 else 0.0
            there_ns = was_ns + round(share_ratio * (now_ns - was_ns))
            self.due_ns = max(self._soonest_ns, there_ns)


class Inventing:
    def __init__(self, world: World, parameters: TagFalse, generator: np.random.Generator) -> None:
        tag_id = parameters.tag_id
        unknown = TagSite(tag_id=tag_id, position_m=0.0, kind=TagKind.BALISE)
        self._site = world.tag_reader.site_of(tag_id) or unknown
        self._reading = FalseReadings(world, generator)
        self.touched = 0
        """Number of readings of a tag that is not there."""

    def begin(self, now_ns: int) -> None:
        self._reading.read(self._site, now_ns)
        self.touched += 1

    def end(self, now_ns: int) -> None:
        """Do nothing: the false tag is read only once."""

    def step(self, now_ns: int) -> bool:
        return False


def _concerns(wanted: int | None, tag_id: int) -> bool:
    return wanted is None or wanted == tag_id
