"""`vobc line`, `master`, `switch-master` and `out-of-service`: supervision of a line over zenoh."""

import argparse
import sys
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from typing import Final, NamedTuple

from firmware_py.clock import WallClock
from firmware_py.ports import RadioMessage, RadioPort
from firmware_py.radio.zenoh_radio import RadioError, Role, open_radio
from firmware_py.settings import SettingsError
from firmware_py.trackdb.areas import AreaMap, load_areas
from metro_hil.options import EXIT_ENVIRONMENT, EXIT_OK, EXIT_USAGE
from zenoh_config import t2t_keys
from zenoh_config.codec import pack, unpack
from zenoh_config.messages import WAYSIDE
from zenoh_config.t2t import (
    LAST_TRAIN,
    NOBODY,
    Heartbeat,
    LineOrder,
    OrderKind,
    Phase,
    T2tMessage,
    TrainReport,
)

ENDPOINT: Final = "tcp/127.0.0.1:7448"
NS_PER_S: Final = 1e9
BEAT_NS: Final = 50_000_000
LOOK_S: Final = 1.5
"""So long is listened before anything is said."""
ORDER_S: Final = 3.0
SILENT_S: Final = 1.0


class Command(NamedTuple):
    """Who commands an area, as last heard."""

    heartbeat: Heartbeat
    heard_ns: int
    since_ns: int
    """When this term was heard first."""
    before: int
    """Who commanded before; NOBODY: nobody was heard."""


class LineView:
    """What supervision has heard; the newest of each, whoever else may have said what."""

    def __init__(self, areas: AreaMap) -> None:
        self.areas = areas
        self.commands: dict[int, Command] = {}
        self.reports: dict[int, tuple[TrainReport, int]] = {}
        """By train: of the area that it last reported to as a member."""

    def hears(self, messages: Iterable[RadioMessage], now_ns: int) -> None:
        for message in messages:
            heard = unpack(message.payload)
            if not isinstance(heard, T2tMessage):
                continue
            if message.key != t2t_keys.key_of(self.areas.name, heard):
                continue
            if isinstance(heard, Heartbeat):
                self._hears_heartbeat(heard, now_ns)
            elif isinstance(heard, TrainReport):
                self._hears_report(heard, now_ns)

    def _hears_heartbeat(self, heartbeat: Heartbeat, now_ns: int) -> None:
        known = self.commands.get(heartbeat.area)
        if known is None:
            self.commands[heartbeat.area] = Command(heartbeat, now_ns, now_ns, NOBODY)
        elif heartbeat.term > known.heartbeat.term:
            before = known.heartbeat.source
            self.commands[heartbeat.area] = Command(heartbeat, now_ns, now_ns, before)
        elif heartbeat.term == known.heartbeat.term:
            self.commands[heartbeat.area] = known._replace(heartbeat=heartbeat, heard_ns=now_ns)

    def _hears_report(self, report: TrainReport, now_ns: int) -> None:
        known = self.reports.get(report.source)
        owner = self.areas.area_at(report.front_min_m).number
        if known is None or report.area == owner or known[0].area != owner:
            self.reports[report.source] = (report, now_ns)

    def words(self, now_ns: int) -> list[str]:
        """Areas, then trains, the foremost first."""
        said = [self._area_words(area.number, now_ns) for area in self.areas.areas]
        trains = sorted(self.reports.values(), key=lambda each: -each[0].front_max_m)
        head = f"train {'front m':>9} {'km/h':>6} {'authority to m':>15} {'term':>5} {'age s':>6}"
        return [*said, head, *[_train_words(report, now_ns - at) for report, at in trains]]

    def _area_words(self, area: int, now_ns: int) -> str:
        command = self.commands.get(area)
        if command is None:
            return f"area {area}: nobody commands"
        heartbeat, silent_s = command.heartbeat, (now_ns - command.heard_ns) / NS_PER_S
        doing = "commands" if heartbeat.phase is Phase.ISSUING else "takes over"
        standby = f"train {heartbeat.standby}" if heartbeat.standby else "nobody"
        words = f"area {area}: train {heartbeat.source} {doing}, term {heartbeat.term}"
        words += f", standby {standby}"
        if command.before != NOBODY:
            words += f"; before, train {command.before} did"
        if silent_s > SILENT_S:
            words += f"; silent for {silent_s:.1f} s"
        return words


def _train_words(report: TrainReport, age_ns: int) -> str:
    end = f"{report.held_end_m:.1f}" if report.member else "–"
    front = f"{report.front_max_m:.1f}" if report.localised else "lost"
    return (
        f"{report.source:>5} {front:>9} {report.speed_mps * 3.6:>6.1f} {end:>15} "
        f"{report.term:>5} {age_ns / NS_PER_S:>6.2f}"
    )


def order(
    kind: OrderKind, train: int, command: Command, *, boot: int, sequence: int, now_ns: int
) -> LineOrder:
    """To whoever commands the area now, the source of its heartbeat."""
    heartbeat = command.heartbeat
    head = (WAYSIDE, heartbeat.source, heartbeat.area, heartbeat.term, boot, sequence, now_ns)
    return LineOrder(*head, kind, train)


def main(words: Sequence[str]) -> int:
    """Exit 2 for what is no train, line or endpoint; 3 when nobody does what was asked."""
    options = _parser().parse_args(words)
    try:
        return _supervise(options, load_areas(options.line))
    except (SettingsError, RadioError) as error:
        print(f"vobc: {error}", file=sys.stderr)
        return EXIT_USAGE
    except KeyboardInterrupt:
        return EXIT_OK


def _supervise(options: argparse.Namespace, areas: AreaMap) -> int:
    clock, view = WallClock(), LineView(areas)
    topics = t2t_keys.of_supervision(areas.name)
    with open_radio(Role.TRAIN, options.line_radio, topics, clock) as port:
        desk = _Desk(clock, view, port)
        desk.listen(LOOK_S)
        if options.verb == "line":
            while options.watch:
                desk.say(view.words(clock.now_ns()), over=True)
                desk.listen(0.5)
            desk.say(view.words(clock.now_ns()))
            return EXIT_OK if view.commands else _nobody(areas)
        if options.verb == "master":
            desk.say(view.words(clock.now_ns())[: len(areas.areas)])
            return EXIT_OK if view.commands else _nobody(areas)
        if options.verb == "switch-master":
            if options.area not in {area.number for area in areas.areas}:
                raise SettingsError(f"--area {options.area}: {areas.name} has no such area")
            return desk.switch(options.area, options.to)
        return desk.retire(options.number)


class _Desk:
    def __init__(self, clock: WallClock, view: LineView, port: RadioPort) -> None:
        self._clock, self._view, self._port = clock, view, port
        self._boot = clock.epoch_ns() // 1_000_000_000
        self._sequence = 0

    def listen(self, duration_s: float, until: Callable[[], bool] = lambda: False) -> bool:
        """Whether what is waited for came."""
        end_ns = self._clock.now_ns() + round(duration_s * NS_PER_S)
        while self._clock.now_ns() < end_ns:
            self._clock.wait_until(self._clock.now_ns() + BEAT_NS)
            now_ns = self._clock.now_ns()
            self._view.hears(self._port.receive(now_ns), now_ns)
            if until():
                return True
        return False

    def say(self, lines: Sequence[str], *, over: bool = False) -> None:
        clear = "\033[2J\033[H" if over and sys.stdout.isatty() else ""
        print(clear + "\n".join(lines), flush=True)

    def switch(self, area: int, to: int) -> int:
        """Ask until another commands, or it is clear that none will."""
        command = self._view.commands.get(area)
        if command is None:
            return _nobody(self._view.areas)

        def switched() -> bool:
            now = self._view.commands[area]
            if now.heartbeat.source == to:
                return True
            self._order(OrderKind.SWITCH_MASTER, to, now)
            return False

        if self.listen(ORDER_S, switched):
            print(f"area {area}: train {to} commands")
            return EXIT_OK
        print(f"vobc: train {to} did not take area {area} over; is it there?", file=sys.stderr)
        return EXIT_ENVIRONMENT

    def retire(self, train: int) -> int:
        """Tell every master, for as long as it takes the train to command nothing."""

        def retired() -> bool:
            for command in self._view.commands.values():
                self._order(OrderKind.OUT_OF_SERVICE, train, command)
                # And the train itself, which says so to every master there will be.
                itself = command._replace(heartbeat=replace(command.heartbeat, source=train))
                self._order(OrderKind.OUT_OF_SERVICE, train, itself)
            commands = [each.heartbeat for each in self._view.commands.values()]
            return all(train not in (each.source, each.standby) for each in commands)

        if not self._view.commands:
            return _nobody(self._view.areas)
        if self.listen(ORDER_S, retired):
            print(f"train {train} commands nothing and stands by for nobody")
            return EXIT_OK
        print(f"vobc: nobody could take over from train {train}", file=sys.stderr)
        return EXIT_ENVIRONMENT

    def _order(self, kind: OrderKind, train: int, command: Command) -> None:
        self._sequence += 1
        now_ns = self._clock.now_ns()
        message = order(
            kind, train, command, boot=self._boot, sequence=self._sequence, now_ns=now_ns
        )
        key = t2t_keys.key_of(self._view.areas.name, message)
        self._port.send(now_ns, key, pack(message))


def _nobody(areas: AreaMap) -> int:
    print(f"vobc: nobody is heard on {areas.name}", file=sys.stderr)
    return EXIT_ENVIRONMENT


def _parser() -> argparse.ArgumentParser:
    top = argparse.ArgumentParser(prog="vobc", description=__doc__)
    verbs = top.add_subparsers(dest="verb", required=True, metavar="VERB")
    line = verbs.add_parser("line", help="show areas and trains of a line")
    line.add_argument("--watch", action="store_true", help="go on until Ctrl-C")
    master = verbs.add_parser("master", help="who commands which area, and since whom")
    switch = verbs.add_parser("switch-master", help="let another train command an area")
    switch.add_argument("--area", type=int, required=True)
    switch.add_argument("--to", type=_train, required=True, metavar="TRAIN")
    retire = verbs.add_parser("out-of-service", help="let a train command nothing any more")
    retire.add_argument("number", type=_train, metavar="TRAIN")
    for verb in (line, master, switch, retire):
        verb.add_argument("--line", default="loop", metavar="NAME|FILE", help="default: loop")
        verb.add_argument("--line-radio", default=ENDPOINT, metavar="ENDPOINT")
    return top


def _train(text: str) -> int:
    number = text.removeprefix("T")
    if not (number.isascii() and number.isdecimal()) or not 0 < int(number) <= LAST_TRAIN:
        raise argparse.ArgumentTypeError(f"{text} is no train; they are 1..{LAST_TRAIN}, or T1 ...")
    return int(number)
