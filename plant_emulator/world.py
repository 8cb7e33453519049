"""One train on its line. Actuators move it and sensors measure it; no code here knows of buses."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

from can_dbc.alarms import TrainAlarms
from can_dbc.analogue import AnalogueCommand
from can_dbc.binding import timeout_s
from can_dbc.brake import BrakeCommand
from can_dbc.cab import CabMode, Desk
from can_dbc.diagnostics import TcmsStatus
from can_dbc.doors import DoorCommand
from can_dbc.nodes import Node
from can_dbc.traction import TractionCommand
from firmware_py.settings import SettingsError, nearest, override
from firmware_py.trackdb import LineMap, Station, load_line
from firmware_py.trackdb.circuit import load_switched
from firmware_py.trackdb.network import TrackNetwork
from firmware_py.trackdb.paths import Path
from plant_emulator.actuators.adhesion import WheelGroup
from plant_emulator.actuators.brake import BrakeUnit
from plant_emulator.actuators.doors import DoorUnit
from plant_emulator.actuators.loops import Loops
from plant_emulator.actuators.response import FAR_NS
from plant_emulator.actuators.traction import TractionUnit
from plant_emulator.consist import Consist
from plant_emulator.consist.track import GRAVITY_MPS2
from plant_emulator.desk.attendant import check_driver
from plant_emulator.desk.hands import unattended as unattended
from plant_emulator.desk.recording import DeskRecording, load_recording
from plant_emulator.foreign import ForeignParts
from plant_emulator.noise import Generators, NoiseSource
from plant_emulator.power import HighVoltageBox
from plant_emulator.sensors.cold import ColdDetector
from plant_emulator.sensors.inertial import Accelerometer, DopplerRadar
from plant_emulator.sensors.tacho import Tachos
from plant_emulator.sensors.tag_reader import TagReader
from plant_emulator.train_config import TrainConfig, load_train, with_overrides

STEP_NS: Final = 10_000_000
STEP_S: Final = STEP_NS / 1e9
NOTHING: Final[Mapping[str, Any]] = {}


@dataclass(frozen=True, slots=True)
class TrainScenario:
    """One train on one line with its start and its destination."""

    train: TrainConfig
    line: LineMap
    start: Station
    destination: Station
    seed: int
    desk_mode: CabMode = CabMode.AUTO
    driver: str | None = None
    """Name of the driver model at the desk, see `plant_emulator.desk.drivers`."""
    desk_recording: DeskRecording | None = None
    """The recording that is replayed at the desk."""
    desk_elsewhere: bool = False
    """The desk is a separate node, so this plant sends no desk frames."""
    wayside_line: LineMap | None = None
    """Map of the wayside if its survey is wrong; None: the true line."""
    tracks: tuple[TrackNetwork, Path] | None = None
    """The network with the train's path, if it has switches."""
    layover_s: float = 0.0
    """Time at the start for which the wayside keeps the train there."""
    turned: "TurnedTrain | None" = None
    """State of the train after a run before this one; None: a new one at its starting point."""

    @property
    def network(self) -> TrackNetwork | None:
        """The network, if it has switches."""
        return None if self.tracks is None else self.tracks[0]


@dataclass(frozen=True, slots=True)
class TurnedTrain:
    """What a train keeps when it goes on in the other direction."""

    front_m: float
    """True chainage of the front coupler on the path that it leaves by."""
    tags_m: Mapping[int, float]
    """Chainage of that path at which the antenna detects each tag, by number."""
    seed: int
    """Seed of all random numbers that are not sampled once a run."""


def plan_scenario(
    *,
    line: str = "florence",
    consist: str = "florence4",
    seed: int = 1,
    start: str | None = None,
    end: str | None = None,
    load_ratio: float | None = None,
    odometer_error_ratio: float | None = None,
    desk_mode: CabMode | str = CabMode.AUTO,
    real: Mapping[str, Any] = NOTHING,
    driver: str | None = None,
    desk_recording: str | None = None,
    desk_elsewhere: bool = False,
) -> TrainScenario:
    """Load train and line and check that they fit each other.

    None selects the file's value or the whole line.

    Args:
        desk_mode: the mode, or its name in lower case.
        driver: name of a driver model: obedient, reckless or late.
        desk_recording: file of a recording to replay at the desk.
        real: changes of the consist's file by dotted key, see `firmware_py.settings.override`.

    Raises SettingsError.
    """
    train = load_train(consist)
    train = override(train, real, consist)
    try:
        train = with_overrides(
            train, load_ratio=load_ratio, odometer_error_ratio=odometer_error_ratio
        )
    except ValueError as error:
        raise SettingsError(f"{consist}: {error}") from error
    track = load_line(line).for_train(train.length_m)
    first = _station(track, start or track.stations[0].name, "--from")
    last = _station(track, end or track.stations[-1].name, "--to")
    if last.stop_m <= first.stop_m:
        raise SettingsError(
            f"--to {last.name}: lies at {last.stop_m:g} m, not beyond {first.name} at "
            f"{first.stop_m:g} m; trains run towards growing chainage"
        )
    if first.stop_m - train.length_m < track.start_m:
        raise SettingsError(
            f"--from {first.name}: the train of {train.length_m:g} m reaches back over the line's "
            f"start at {track.start_m:g} m"
        )
    if (driver is not None) + (desk_recording is not None) + desk_elsewhere > 1:
        raise SettingsError(
            "driver, desk_recording, desk elsewhere: choose only one operator of the desk"
        )
    return TrainScenario(
        train,
        track,
        first,
        last,
        seed,
        _desk_mode(desk_mode),
        driver=None if driver is None else check_driver(driver),
        desk_recording=None if desk_recording is None else load_recording(desk_recording),
        desk_elsewhere=desk_elsewhere,
        tracks=load_switched(line),
    )


class World:
    """The true state of train and line.

    The units receive commands and give frames; `step` advances everything by STEP_S.
    """

    def __init__(
        self,
        train: TrainConfig,
        line: LineMap,
        *,
        seed: int,
        front_m: float,
        start_ns: int = 0,
        desk_mode: CabMode = CabMode.AUTO,
        foreign: ForeignParts | None = None,
    ) -> None:
        """Create a train at rest with its front at `front_m`, brakes applied and doors closed.

        Args:
            foreign: program that emulates parts of the train.
        """
        generators = Generators(seed)
        self.seed = seed
        """Seed of all random numbers generated from now on."""
        self.train = train
        self.length_m = train.length_m
        self.load_cell_ratio = 1.0
        """A fault: factor on the passenger mass that the load cells report."""
        self.line = line
        self._dead_zones = line.neutral_sections
        """Zones in which the line feeds nothing now."""
        self._isolated = False
        self._start_m = front_m
        self.now_ns = start_ns
        resistance_error = train.resistance.error_ratio.draw(generators.of(NoiseSource.RESISTANCE))
        self.consist = Consist(
            train,
            line,
            front_m=front_m,
            step_s=STEP_S,
            resistance_ratio=1.0 + resistance_error,
        )
        self._make_actuators(generators)
        self._make_sensors(generators, front_m)
        self.desk = unattended(desk_mode)
        """The desk frame as the bus shows it."""
        self._untouched_desk = self.desk
        self._desk_faults: Sequence[Mapping[str, Any]] = ()
        self.alarms = TrainAlarms(no_obstacle=True, no_fire=True)
        self.cold = ColdDetector(front_m)
        self.adhesion_ratio = train.rail.adhesion_ratio
        self.drive_n = 0.0
        """Tractive effort that the rail transmitted in the last step, signed, N."""
        self.brake_n = 0.0
        """Brake force that the rail transmitted in the last step, never negative, N."""
        self._braked_n = (0.0, 0.0)
        """Share of `brake_n` of the motor cars and of the trailers, N."""
        self.foreign = foreign
        self.told: dict[str, float] = {}
        """Truth signals that a program outside the bench reported for its parts."""

    def _make_actuators(self, generators: Generators) -> None:
        train, consist = self.train, self.consist
        motor_kg = sum(
            car.tare_kg + train.load_ratio * car.passengers_kg for car in train.cars if car.motor
        )
        self.brake = BrakeUnit(
            train.brake,
            generators,
            step_s=STEP_S,
            timeout_ns=round(timeout_s(BrakeCommand) * 1e9),
            inertia_kg=consist.inertia_kg,
            motor_ratio=motor_kg / train.mass_kg,
        )
        self.traction = TractionUnit(
            train.traction,
            step_s=STEP_S,
            timeout_ns=round(timeout_s(TractionCommand) * 1e9),
        )
        self.doors = DoorUnit(
            train.doors,
            cars=len(train.cars),
            step_s=STEP_S,
            timeout_ns=round(timeout_s(DoorCommand) * 1e9),
        )
        self.power = HighVoltageBox(
            train.supply,
            step_s=STEP_S,
            traction_efficiency_ratio=train.traction.efficiency_ratio,
            electric_efficiency_ratio=train.brake.service.electric.efficiency_ratio,
        )
        electric = train.brake.service.electric
        self._mapped = not (train.traction.efficiency is None and electric.efficiency is None)
        self.loops: Loops | None = None
        """The analogue loops; None if traction and service brake take their reference from the
        bus."""
        self._analogue_ns = round(timeout_s(AnalogueCommand) * 1e9)
        self._unready_until_ns = FAR_NS
        if train.loop.connected:
            self.loops = Loops(train.loop, generators, timeout_ns=self._analogue_ns)
            self.brake.refer(0.0, self.now_ns)
            self.traction.refer(0.0, self.now_ns)
        self.motor_wheels = self._wheels(motor_kg)
        self.trailer_wheels = self._wheels(train.mass_kg - motor_kg)

    def _wheels(self, mass_kg: float) -> WheelGroup:
        return WheelGroup(
            self.train.rail,
            step_s=STEP_S,
            weight_n=mass_kg * GRAVITY_MPS2,
            rotating_kg=mass_kg * self.train.rotating_mass_percent / 100.0,
        )

    def _make_sensors(self, generators: Generators, front_m: float) -> None:
        sensors = self.train.sensors
        self.tachos = Tachos(
            sensors,
            generators,
            cars=len(self.consist.cars),
            front_m=front_m,
            step_s=STEP_S,
        )
        on_motor_car = [self.train.cars[tacho.car - 1].motor for tacho in sensors.tachos]
        self._wheels_a = self.motor_wheels if on_motor_car[0] else self.trailer_wheels
        self._wheels_b = self.motor_wheels if on_motor_car[1] else self.trailer_wheels
        self.doppler = DopplerRadar(sensors, generators)
        self.imu = Accelerometer(sensors, generators, self.now_ns)
        self.tag_reader = TagReader(
            sensors, generators, self.line.tags, front_m=front_m, start_ns=self.now_ns
        )

    def step(self) -> None:
        """Advance by STEP_S with the commands received so far."""
        start_ns = self.now_ns
        end_ns = start_ns + STEP_NS
        brake, consist = self.brake, self.consist
        speed_mps = consist.speed_mps
        if self._dead_zones:
            self._pass_dead_zones()
        if self.loops is not None:
            self._read_loops(self.loops, start_ns)
        elif end_ns > self._unready_until_ns:
            self._unready_until_ns = FAR_NS
            brake.ready = self.traction.ready = True
        self.doors.step(end_ns)
        brake.step(
            start_ns,
            end_ns,
            speed_mps,
            electric_possible=self.traction.electric_brake_possible,
            electric_limit_w=self.power.electric_limit_w,
        )
        drive_n = self.traction.step(
            start_ns,
            end_ns,
            speed_mps,
            emergency=self.emergency_wanted,
            # The sealed bypass switch bridges the loop through the door locks.
            doors_locked=self.doors_locked or self.desk.door_bypass_requested,
        )
        self._press_on_rail(drive_n, speed_mps)
        if self.foreign is not None:
            self._ask(self.foreign, end_ns)
        if self.drive_n == 0.0 and brake.electric_n == 0.0:
            self._move()
            self.power.rest()
        else:
            motor_m = consist.motor_m
            self._move()
            self._book_energy(consist.motor_m - motor_m)
        self.tachos.step(consist.car_fronts_m, self._wheels_a.slip_mps, self._wheels_b.slip_mps)
        self.tag_reader.step(consist.car_fronts_m[0], start_ns, end_ns, self.tachos)
        self.now_ns = end_ns

    def _ask(self, foreign: ForeignParts, end_ns: int) -> None:
        """Let the other program advance its parts, and take over what it reports."""
        motor_n, trailer_n = self._braked_n
        if Node.TCU in foreign.nodes:
            self.drive_n = 0.0
        if Node.BCU in foreign.nodes:
            motor_n = trailer_n = 0.0
        told = foreign.step(
            end_ns,
            {
                "drive_n": self.drive_n,
                "motor_brake_n": motor_n,
                "trailer_brake_n": trailer_n,
                "gradient_permille": self.gradient_permille,
            },
        )
        self.told = dict(told)
        self.drive_n = told.get("drive_n", self.drive_n)
        if "brake_n" in told:
            motor_n, trailer_n = told["brake_n"], 0.0
        self.brake_n = motor_n + trailer_n
        self.consist.load(self.drive_n, motor_n, trailer_n)

    def _move(self) -> None:
        told = self.told
        if "front_m" in told:
            self.consist.place(told["front_m"], told["speed_mps"], told["accel_mps2"])
        else:
            self.consist.step()

    @property
    def emergency_wanted(self) -> bool:
        """Whether the brake unit demands the emergency brake."""
        told = self.told.get("emergency")
        return self.brake.emergency_wanted if told is None else told != 0.0

    @property
    def doors_locked(self) -> bool:
        """Whether the train line through all door locks is closed."""
        told = self.told.get("doors_locked")
        return self.doors.locked if told is None else told != 0.0

    def hear_currents(self, command: AnalogueCommand, heard_ns: int) -> None:
        """Pass the commanded currents to the loops.

        On a train without loops, brake and traction report not ready while this command arrives,
        because such a controller expects another train.
        """
        if self.loops is not None:
            self.loops.hear(command, heard_ns)
            return
        self._unready_until_ns = heard_ns + self._analogue_ns
        self.brake.ready = self.traction.ready = False

    def _read_loops(self, loops: Loops, now_ns: int) -> None:
        brake, traction = self.brake, self.traction
        inertia_kg = self.consist.inertia_kg
        loops.step(now_ns, traction_mps2=traction.said_n / inertia_kg, brake_mps2=brake.said_mps2)
        brake.ready, traction.ready = loops.brake.trusted, loops.traction.trusted
        decel_mps2 = loops.brake.reference_mps2
        if not brake.ready:
            decel_mps2 = max(decel_mps2, brake.said_mps2)
        brake.refer(decel_mps2, now_ns)
        pull_mps2 = loops.traction.reference_mps2 if traction.ready else 0.0
        traction.refer(pull_mps2 * inertia_kg, now_ns)

    def reseed(self, seed: int) -> None:
        """Generate all further random numbers from another seed.

        Values that are sampled once a run stay: running resistance, scale of odometer and radar,
        bias of the accelerometer. The brake samples its lags and gains once more at the next
        application from rest, so that continuations brake like runs of their own.
        """
        generators = Generators(seed)
        self.seed = seed
        self.brake.service.reseed(generators)
        self.doppler.reseed(generators)
        self.imu.reseed(generators)
        self.tag_reader.reseed(generators)

    def connect_supply(self, no_load_v: float | None, *, breaker_closed: bool) -> None:
        """A fault: the line feeds from another source or the breaker is open.

        None stands for the train's normal source.
        """
        self.power.connect(no_load_v, breaker_closed=breaker_closed)
        self._feed_traction()

    def _feed_traction(self) -> None:
        self.traction.powered = self.power.live
        self.traction.feed(self.power.effort_ratio)

    def switch_off(self, sections: Collection[str]) -> None:
        """A fault: the power sections of these names carry no voltage, and no others."""
        off = (each for each in self.line.power_sections if each.name in sections)
        self._dead_zones = (*self.line.neutral_sections, *off)
        self._pass_dead_zones()

    def is_in(self, section: str) -> bool:
        """Whether any part of the train is in a power section of this name."""
        front_m = self.front_m
        return any(
            each.name == section and each.covers(front_m - self.length_m, front_m)
            for each in self.line.power_sections
        )

    def _pass_dead_zones(self) -> None:
        """Isolate the train while any part of it is in a zone without voltage."""
        front_m = self.front_m
        rear_m = front_m - self.length_m
        inside = any(each.covers(rear_m, front_m) for each in self._dead_zones)
        if inside is not self._isolated:
            self._isolated = inside
            self.power.isolate(inside)
            self._feed_traction()

    def put_desk(self, desk: Desk) -> None:
        """Set the desk as operated by hand; active desk faults override it."""
        self._untouched_desk = desk
        for change in self._desk_faults:
            desk = replace(desk, **change)
        self.desk = desk

    @property
    def own_desk(self) -> Desk:
        """The desk as operated by hand, without the faults."""
        return self._untouched_desk

    def disturb_desk(self, changes: Sequence[Mapping[str, Any]]) -> None:
        """Faults: from now on these fields of the desk frame are fixed, whatever the driver
        does.
        """
        self._desk_faults = changes
        self.put_desk(self._untouched_desk)

    def excuse(self, held_up_ns: int) -> None:
        """Extend all command timeouts by the time for which the bench itself was stopped."""
        for unit in (self.brake, self.traction, self.doors):
            unit.excuse(held_up_ns)
        if self.loops is not None:
            self.loops.excuse(held_up_ns)

    def keep(self, turned: TurnedTrain) -> None:
        """Keep what the train has from its run before. Call this before the first step."""
        self.reseed(turned.seed)
        self.tag_reader.mount(turned.tags_m)

    def keep_power(self, power: HighVoltageBox) -> None:
        """Go on with the high-voltage box of the run before, its meter and the resistor's heat."""
        self.power = power
        power.isolate(False)
        self._feed_traction()

    def pass_over(self, steps: int) -> None:
        """Skip time without any movement, for a process that was delayed for too long."""
        self.now_ns += steps * STEP_NS

    def _press_on_rail(self, drive_n: float, speed_mps: float) -> None:
        """Limit the forces by adhesion and apply the result to the train."""
        adhesion_ratio, brake = self.adhesion_ratio, self.brake
        trailer_n = self.trailer_wheels.braked(brake.trailer_n, adhesion_ratio, speed_mps)
        if drive_n == 0.0:
            motor_n = self.motor_wheels.braked(brake.motor_n, adhesion_ratio, speed_mps)
        else:
            # While the wheels pull against their own brake, only the tractive effort can make them
            # spin.
            drive_n = self.motor_wheels.driven(drive_n, adhesion_ratio, speed_mps)
            motor_n = min(brake.motor_n, self.motor_wheels.most_n(adhesion_ratio))
        self.drive_n = drive_n
        self._braked_n = (motor_n, trailer_n)
        self.brake_n = motor_n + trailer_n
        self.consist.load(drive_n, motor_n, trailer_n)

    def _convert_by_maps(self, electric_n: float) -> None:
        """Set the efficiencies for this speed and these forces."""
        traction, electric = self.train.traction, self.train.brake.service.electric
        speed_mps = abs(self.speed_mps)
        pulls, brakes = traction.efficiency_ratio, electric.efficiency_ratio
        if traction.efficiency is not None:
            load_ratio = abs(self.drive_n) / traction.rated_force_n
            pulls = traction.efficiency.at(speed_mps, load_ratio)
        if electric.efficiency is not None:
            load_ratio = electric_n / max(1.0, electric.max_force_n)
            brakes = electric.efficiency.at(speed_mps, load_ratio)
        self.power.convert(pulls, brakes)

    def _book_energy(self, moved_m: float) -> None:
        power = self.power
        electric_n = min(self.brake.electric_n, self.brake_n)
        if self._mapped:
            self._convert_by_maps(electric_n)
        power.step(self.drive_n * moved_m, electric_n * abs(moved_m))
        self.traction.feed(power.effort_ratio)

    @property
    def front_m(self) -> float:
        """Chainage of the front coupler, m."""
        return self.consist.car_fronts_m[0]

    @property
    def speed_mps(self) -> float:
        """Speed of the whole train; exactly zero at standstill."""
        return self.consist.speed_mps

    @property
    def odometer_error_m(self) -> float:
        """Distance counted by tacho A, for a wheel of nominal diameter, minus the true distance
        since the start.
        """
        return self.tachos.counted_m - (self.front_m - self._start_m)

    @property
    def gradient_permille(self) -> float:
        """Mean gradient under the train."""
        front_m = self.front_m
        return self.line.mean_gradient_permille(front_m - self.train.length_m, front_m)

    def load_status(self) -> TcmsStatus:
        return TcmsStatus(
            load_kg=self.train.passengers_kg * self.train.load_report_ratio * self.load_cell_ratio,
            cars=len(self.train.cars),
        )


def world_of(scenario: TrainScenario, start_ns: int, foreign: ForeignParts | None = None) -> World:
    """The train of a scenario at its start."""
    turned = scenario.turned
    world = World(
        scenario.train,
        scenario.line,
        seed=scenario.seed,
        front_m=scenario.start.stop_m if turned is None else turned.front_m,
        start_ns=start_ns,
        desk_mode=scenario.desk_mode,
        foreign=foreign,
    )
    if turned is not None:
        world.keep(turned)
    return world


def _desk_mode(mode: CabMode | str) -> CabMode:
    if isinstance(mode, CabMode):
        return mode
    names = {known.name.lower(): known for known in CabMode}
    if mode not in names:
        raise SettingsError(f"desk_mode: {mode!r}: {nearest(mode, list(names))}")
    return names[mode]


def _station(line: LineMap, name: str, option: str) -> Station:
    try:
        return line.station(name)
    except KeyError as error:
        raise SettingsError(f"{option} {name}: {error.args[0]}") from None
