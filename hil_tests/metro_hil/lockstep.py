"""Controller and plant in one process in virtual time: same code, same frames, no waiting."""

from contextlib import ExitStack

from can_dbc.nodes import Node
from firmware_py.buses.inproc import InprocBus
from firmware_py.clock import LockstepClock, WallClock
from firmware_py.executive import Executive, Task, run
from firmware_py.nvram import Nvram, NvramRecord
from firmware_py.ports import CanFrame, CanPort, SerialPort
from firmware_py.radio.inproc_radio import InprocRadio
from firmware_py.recorder import CandumpWriter, LineLog, SerialLog
from firmware_py.tag_reader.inproc_line import inproc_line
from firmware_py.tag_reader.recorded_line import RecordedLine
from metro_hil.ending import ARRIVED, DURATION, ArrivalWatch, Ending
from metro_hil.journey import Journey
from metro_hil.options import RunOptions
from metro_hil.run_folder import RunFolder
from plant_emulator.process import TRUTH_COLUMNS, PlantDevice
from plant_emulator.world import Scenario, plan_scenario
from vobc.config import VobcConfig, load_config
from vobc.process import CYCLE_COLUMNS, VobcDevice
from vobc.wire import HEARD_IDS
from zenoh_config import keys

BIT_RATE = 250_000
BUS_NAME = "vcan0"
LIMIT_S = 4.0 * 3600.0
"""A train that has not arrived after so long never will."""
TIME_UP = f"not arrived within {LIMIT_S / 3600.0:.0f} h"
WATCH_MS = 500.0
NS_PER_S = 1_000_000_000


class Lockstep:
    """One train and its world on a bus of virtual time, ready to run."""

    def __init__(
        self,
        config: VobcConfig,
        scenario: Scenario,
        journey: Journey,
        folder: RunFolder | None = None,
    ) -> None:
        """Without a folder nothing is logged. Raises RecorderError for a log that cannot be."""
        self.clock = LockstepClock()
        self._stack = ExitStack()
        self._writer = None if folder is None else CandumpWriter(folder.bus_log, BUS_NAME)
        self.bus = InprocBus(BUS_NAME, BIT_RATE, None if self._writer is None else self._record)
        self._logs: list[LineLog | CandumpWriter] = []
        if self._writer is not None:
            self._logs.append(self._writer)
            self._stack.callback(self._writer.close)
        radio = InprocRadio()
        controller_end, reader_end = inproc_line()
        line = journey.line
        self.plant = PlantDevice(
            scenario,
            open_port=self._open_node,
            tags=reader_end,
            radio=radio.port("wayside", (keys.reports(line.name),)),
            truth=self._log(folder, "truth.csv", TRUTH_COLUMNS),
            start_ns=0,
        )
        self.vobc = VobcDevice(
            config,
            line,
            journey.mission,
            can=self.bus.port(Node.VOBC.name, HEARD_IDS),
            tags=self._recorded(controller_end, folder),
            radio=radio.port("train", (keys.authorities(line.name, config.address),)),
            nvram=Nvram(None, NvramRecord(boot_count=1)),
            cycle_log=self._log(folder, "cycles.csv", CYCLE_COLUMNS),
            start_ns=0,
        )
        self._arrival = ArrivalWatch(journey.end.stop_m)
        self._reason = ""

    def run(self, duration_s: float | None = None) -> str:
        """Until the train has arrived or time is over; says which."""
        limit_s = LIMIT_S if duration_s is None else min(duration_s, LIMIT_S)
        end_ns = self.clock.now_ns() + int(limit_s * NS_PER_S)
        self._reason = ""
        watch = Executive([Task("watch", WATCH_MS, self._watch)], self.clock.now_ns())
        executives = [self.plant.executive, self.vobc.executive, watch]
        run(executives, self.clock, lambda now_ns: now_ns >= end_ns or self._reason != "")
        return self._reason or (DURATION if limit_s == duration_s else TIME_UP)

    def close(self) -> None:
        """Say the last word on the bus, let it be carried, and close the logs."""
        now_ns = self.clock.now_ns()
        self.vobc.stop(now_ns)
        self.plant.stop(now_ns)
        self.bus.advance(now_ns + NS_PER_S)
        self._stack.close()

    @property
    def lost_log_lines(self) -> int:
        """Lines that the disk did not take so far."""
        return sum(log.lost_lines for log in self._logs)

    def _watch(self, now_ns: int) -> None:
        motion = self.vobc.output.motion
        if motion is None:
            return
        if self._arrival.arrived(now_ns, self.vobc.output.ato_phase, motion.front_m.best):
            self._reason = ARRIVED

    def _open_node(self, node: Node, accept_ids: frozenset[int]) -> CanPort:
        return self.bus.port(node.name, accept_ids)

    def _record(self, frame: CanFrame, _: str) -> None:
        assert self._writer is not None
        self._writer.frame(frame.stamp_ns, frame.can_id, frame.data)

    def _log(self, folder: RunFolder | None, name: str, columns: tuple[str, ...]) -> LineLog | None:
        if folder is None:
            return None
        log = LineLog(folder.path / name, columns)
        self._logs.append(log)
        self._stack.callback(log.close)
        return log

    def _recorded(self, port: SerialPort, folder: RunFolder | None) -> SerialPort:
        if folder is None:
            return port
        recorded = RecordedLine(port, SerialLog(folder.serial_log))
        self._stack.callback(recorded.close)
        return recorded


def scenario_of(options: RunOptions) -> Scenario:
    """The plant's side of a run; raises SettingsError."""
    return plan_scenario(
        line=options.line,
        consist=options.consist,
        seed=options.seed,
        start=options.start,
        end=options.end,
        load_ratio=options.load_ratio,
        odometer_error_ratio=options.odometer_error,
    )


def config_of(options: RunOptions) -> VobcConfig:
    """The controller's side of a run; raises SettingsError."""
    return load_config(options.params, cycle_ms=options.cycle_ms)


def run_lockstep(options: RunOptions, journey: Journey, folder: RunFolder | None) -> Ending:
    """The whole run and how it ended."""
    wall = WallClock()
    bench = Lockstep(config_of(options), scenario_of(options), journey, folder)
    began_ns = wall.now_ns()
    try:
        reason = bench.run(options.duration_s)
    finally:
        bench.close()
    elapsed_ns = max(1, wall.now_ns() - began_ns)
    statistics, virtual_ns = bench.bus.statistics(), bench.clock.now_ns()
    return Ending(
        exit_reason=reason,
        failed=reason not in (ARRIVED, DURATION),
        frames=statistics.frames,
        bus_load_ratio=statistics.load_ratio(max(1, virtual_ns)),
        rejected_frames=dict(bench.plant.wire.refusals),
        real_time_factor=virtual_ns / elapsed_ns,
        lost_log_lines=bench.lost_log_lines,
    )
