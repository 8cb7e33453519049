"""`hil line`: several trains that command themselves on one line, in virtual time."""

import argparse
from typing import TYPE_CHECKING, Final

from metro_hil.engine.errors import UsageError
from metro_hil.options import EXIT_OK

if TYPE_CHECKING:
    from metro_hil.line_bench import BenchTrain, LineBench

EXIT_VIOLATED: Final = 1
LOOK_S: Final = 0.05
NS_PER_S: Final = 1e9


def add(verbs: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    parser = verbs.add_parser(
        "line",
        help="run several trains that command themselves",
        description="Run several trains that command themselves on one line, in virtual time: "
        "whole controllers and plants, the foremost first, each on its way to the second station "
        "ahead. Tells what happens and ends with a table; exit 1 when an authority came nearer to "
        "the train ahead than it may, or a train that is controlled had to brake by emergency.",
    )
    parser.add_argument("--line", default="loop", metavar="NAME", help="default: %(default)s")
    parser.add_argument("--trains", type=int, default=4, metavar="N", help="default: %(default)s")
    parser.add_argument("--for", type=float, default=90.0, dest="duration_s", metavar="SECONDS")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument(
        "--kill-master-at",
        type=float,
        metavar="SECONDS",
        help="the controller of the train that commands the rearmost area dies",
    )
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Raises UsageError and SettingsError for what does not fit together."""
    from firmware_py.trackdb import load_line
    from firmware_py.trackdb.areas import load_areas
    from metro_hil.line_bench import LineBench, Run
    from vobc.config import load_config

    areas, line = load_areas(options.line), load_line(options.line)
    stations = [each.name for each in line.stations]
    if not 1 <= options.trains <= len(stations) - 2:
        raise UsageError(
            f"--trains {options.trains}: the line {line.name} has room for 1 to "
            f"{len(stations) - 2}, each at a station with two more ahead of the foremost"
        )
    if not options.duration_s > 0.0:
        raise UsageError(f"--for {options.duration_s:g}: not a duration")
    ways = [
        Run(stations[at], stations[at + 2])
        for at in range(len(stations) - 3, len(stations) - 3 - options.trains, -1)
    ]
    bench = LineBench(load_config("florence4"), areas, ways, seed=options.seed)
    return _Watch(bench, options.kill_master_at).run(options.duration_s)


class _Watch:
    """Looks at the plants' truth and tells what changes."""

    def __init__(self, bench: "LineBench", kill_at_s: float | None) -> None:
        self._bench, self._kill_at_s = bench, kill_at_s
        self._killed = 0
        self._masters: dict[int, list[int]] = {}
        self._least_m: dict[int, float] = {}
        self._oldest_s: dict[int, float] = {}
        self._emergencies: set[int] = set()

    def run(self, duration_s: float) -> int:
        end_ns = self._bench.clock.now_ns() + round(duration_s * NS_PER_S)
        while self._bench.clock.now_ns() < end_ns:
            self._bench.run(LOOK_S)
            self._look()
        self._table()
        margin_m = self._bench.behind_rear_m
        near = [n for n, gap_m in self._least_m.items() if gap_m < margin_m]
        for number in near:
            print(f"train {number}: authority only {self._least_m[number]:.2f} m behind the next")
        for number in sorted(self._emergencies):
            print(f"train {number}: emergency brake although it was controlled")
        return EXIT_VIOLATED if near or self._emergencies else EXIT_OK

    def _look(self) -> None:
        from can_dbc.vobc import Supervision

        bench, at_s = self._bench, self._bench.clock.now_ns() / NS_PER_S
        for area in bench.areas.areas:
            masters = bench.masters(area.number)
            if masters != self._masters.get(area.number, []):
                self._masters[area.number] = masters
                who = f"train {masters[0]} commands" if masters else "nobody commands"
                print(f"{at_s:8.2f} s  area {area.number}: {who}")
        if self._kill_at_s is not None and at_s >= self._kill_at_s and not self._killed:
            self._kill(at_s)
        ahead: BenchTrain | None = None
        for number, train in bench.trains.items():
            held = train.command.held
            if held is not None and number != self._killed:
                age_s = at_s - held.echo_ns / NS_PER_S
                self._oldest_s[number] = max(age_s, self._oldest_s.get(number, 0.0))
                if train.vobc.output.supervision is Supervision.EMERGENCY:
                    self._emergencies.add(number)
                if ahead is not None:
                    world = ahead.plant.world
                    gap_m = world.front_m - world.length_m - held.end_m
                    self._least_m[number] = min(gap_m, self._least_m.get(number, gap_m))
            ahead = train

    def _kill(self, at_s: float) -> None:
        for area in self._bench.areas.areas:
            masters = self._bench.masters(area.number)
            if masters:
                self._killed = masters[0]
                self._bench.kill(masters[0])
                print(f"{at_s:8.2f} s  the controller of train {masters[0]} dies")
                return

    def _table(self) -> None:
        from rich.console import Console
        from rich.table import Table

        table = Table(box=None)
        for head in ("train", "front m", "km/h", "authority to m", "term", "state", "is"):
            table.add_column(head, justify="left" if head in ("state", "is") else "right")
        table.add_column("oldest ms", justify="right")
        table.add_column("least gap m", justify="right")
        for number, train in self._bench.trains.items():
            held, radio = train.command.held, train.command.radio
            roles = ", ".join(f"{role.value} of {area}" for area, role in radio.roles.items())
            table.add_row(
                str(number),
                f"{train.plant.world.front_m:.1f}",
                f"{train.plant.world.speed_mps * 3.6:.1f}",
                "–" if held is None else f"{held.end_m:.1f}",
                "–" if held is None else str(held.term),
                "dead" if number == self._killed else radio.state.value,
                roles,
                f"{self._oldest_s.get(number, 0.0) * 1000.0:.0f}",
                f"{self._least_m[number]:.1f}" if number in self._least_m else "–",
            )
        Console(highlight=False, width=140).print(table)
