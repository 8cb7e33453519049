"""A line in virtual time in one process: struck, watched and recorded as in real time."""

from collections.abc import Callable
from pathlib import Path
from typing import Final

from firmware_py.clock.executive import Executive
from firmware_py.interrupts import Interrupts
from metro_hil.line.exercise.event_log import OLD, LineEvents
from metro_hil.line.exercise.plan import ONE_WAY, Fault, Strike
from metro_hil.line.exercise.real_time import Settings
from metro_hil.line.exercise.record import LineRunFiles
from metro_hil.line.exercise.schedule import FaultSchedule
from metro_hil.line.train_group import AXLES, LineBench, TrainRun
from plant_emulator.wayside.detection import Place
from vobc.config import load_config
from vobc.train_to_train.vocabulary import T2tConfig
from zenoh_config import t2t_keys
from zenoh_config.t2t import FIRST_ARBITER
from zenoh_config.timers import TIMER_SETS

LOOK_S: Final = 0.05
NS_PER_S: Final = 1_000_000_000
NOT_HERE: Final = (Strike.RESTART_TRAIN, *ONE_WAY)
"""Faults that need processes or network namespaces."""


class VirtualLine:
    def __init__(
        self, settings: Settings, folder: Path, say: Callable[[float, str], None], *, seed: int
    ) -> None:
        """Create the line. Raises SettingsError if line and stations do not fit together."""
        arbiters = tuple(range(FIRST_ARBITER, FIRST_ARBITER + settings.arbiters))
        config = T2tConfig(timers=TIMER_SETS[settings.timers], arbiters=arbiters)
        runs = [TrainRun(*way) for way in settings.ways]
        self.bench = LineBench(
            load_config("florence4"), settings.areas, runs, t2t=config, seed=seed
        )
        self.record = LineRunFiles(folder, say)
        self._tell = self.record.tell
        self.story = LineEvents(settings.line, settings.areas, self._tell)
        self.dropped = 0
        self.doubts: list[str] = []
        """Reasons why the run proves nothing; in virtual time the observer never lags."""
        self.carried: dict[str, dict[str, int]] = {}
        """Packet counts; always empty, as virtual time has no networks."""
        self._settings = settings
        self._tap = self.bench.air.port("tap", t2t_keys.of_line(settings.areas.name))
        self._schedule = FaultSchedule(settings.faults, settings.down_s)

    def run(self) -> bool:
        """Run the line; return whether it ran to its end."""
        bench, interrupts = self.bench, Interrupts()
        end_ns = bench.clock.now_ns() + round(self._settings.duration_s * NS_PER_S)
        try:
            with interrupts.caught():
                while bench.clock.now_ns() < end_ns and not interrupts.asked:
                    bench.run(LOOK_S)
                    self._observe()
                    self._schedule.step(bench.clock.now_ns(), 0, self._apply_fault)
        finally:
            self.record.close()
        if self.dropped:
            self.doubts.append(f"the recorder lost {self.dropped} messages")
        return not interrupts.asked

    def _observe(self) -> None:
        now_ns = self.bench.clock.now_ns()
        heard = self._tap.receive(now_ns)
        self.record.on_message(heard)
        self.story.on_message(heard)
        self.dropped = self._tap.counters.dropped_in
        for number, train in self.bench.trains.items():
            world, output = train.plant.world, train.vobc.output
            rear_m = world.front_m - world.length_m
            self.story.stands(number, Place(world.front_m, rear_m, AXLES, now_ns))
            self.story.tells(number, output.supervision, output.emergency_cause, now_ns)

    def _apply_fault(self, fault: Fault) -> bool:
        """Begin a fault; without a master to strike it is missed. Returns True."""
        bench, now_ns = self.bench, self.bench.clock.now_ns()
        if fault.strike is Strike.CRASH_WAYSIDE:
            self._tell(now_ns, "the wayside with its arbiters dies")
            self.story.excused.add(OLD)
            bench.crash_wayside()
            self._schedule.ends(now_ns, self._restart_wayside)
            return True
        masters = [
            (area.number, m) for area in bench.areas.areas for m in bench.masters(area.number)
        ]
        if not masters:
            words = (
                f"{fault.strike.value.removesuffix('-at')}: no train commands, so none is struck"
            )
            self._tell(now_ns, words)
            self.story.missed_strikes.append(words)
            return True
        area_number, train = masters[0]
        self.story.orders_takeover(area_number, train)
        self.story.strikes(train)
        if fault.strike is Strike.CUT_MASTER:
            self._tell(now_ns, f"the radio of train {train} is cut")
            for other in [*[f"train {n}" for n in bench.trains if n != train], "wayside"]:
                bench.air.cut(f"train {train}", other)
            self._schedule.ends(now_ns, bench.air.heal)
        elif fault.strike is Strike.STOP_MASTER:
            self._tell(now_ns, f"the controller of train {train} stops")
            executive = bench.stop(train)
            self._schedule.ends(now_ns, lambda: self._continue_controller(executive, train))
        else:
            self._tell(now_ns, f"the controller of train {train} dies")
            bench.kill(train)
        return True

    def _restart_wayside(self) -> None:
        self._tell(self.bench.clock.now_ns(), "the wayside with its arbiters is started again")
        self.bench.restart_wayside()

    def _continue_controller(self, executive: Executive, train: int) -> None:
        self._tell(self.bench.clock.now_ns(), f"the controller of train {train} goes on")
        self.bench.go_on(executive)
