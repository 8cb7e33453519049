"""`vobc design-curve`: designs a curve, shows Table I of [Ninh], draws the figure."""

import argparse
import json
import math
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Final

import numpy as np
from rich.console import Console
from rich.table import Table

from firmware_py.clock.clock import WallClock
from firmware_py.command_line import CommandParser
from firmware_py.settings import SettingsError
from firmware_py.storage.whole_file import write_whole
from firmware_py.trackdb import load_line
from metro_hil.energy.running_curve import table_one
from metro_hil.energy.running_curve.answer import (
    OPTIMUM_CELL_M,
    SWEEP,
    DesignAnswer,
    DesignRequest,
    answer,
    as_document,
    net_of,
    reference_curves,
    sweep_of,
)
from metro_hil.energy.running_curve.design import Hop
from metro_hil.energy.running_curve.literal import x_that_the_table_implies_s
from metro_hil.energy.running_curve.net import with_thrift
from metro_hil.energy.running_curve.optimum import NotSolvedError
from metro_hil.energy.running_curve.trace import trace
from metro_hil.energy.running_curve.track import level_track, track_between
from metro_hil.energy.running_curve.train import RunningTrain, load_train
from metro_hil.model.run_folder import RunFolderError, discard_unused, make_run_folder
from metro_hil.model.run_options import EXIT_FAILED, EXIT_OK, EXIT_USAGE
from metro_hil.model.terminal import console_for

DESCRIPTION: Final = (
    "Design the power-limited running curve of one hop after Ninh, Watanabe and Koseki: search the "
    "whole net of times and energies, choose notch-off speed, power limit and braking point for "
    "the running time, and draw the paper's figures 4 to 7 and 10."
)
EPILOG: Final = (
    "exit codes: 0 done; 1 --optimal found no run that passes its checks; 2 wrong usage, "
    "configuration, or no run of just that time"
)
J_PER_MJ, J_PER_KWH, KMH_PER_MPS = 1.0e6, 3.6e6, 3.6


def parser() -> argparse.ArgumentParser:
    """Return the parser of `vobc design-curve`."""
    top = CommandParser(prog="vobc design-curve", description=DESCRIPTION, epilog=EPILOG)
    top.add_argument("--line", default="nanakuma", metavar="NAME|FILE", help="default: nanakuma")
    top.add_argument(
        "--from", dest="start", metavar="STATION", help="default: start of the longest hop"
    )
    top.add_argument("--to", dest="end", metavar="STATION", help="default: the next station")
    top.add_argument("--time", type=_positive, default=72.5, metavar="S", help="default: 72.5")
    top.add_argument(
        "--eta", type=_weight, default=5.0, metavar="N", help="weight of the peak power; default: 5"
    )
    top.add_argument(
        "--train",
        default="seed002",
        metavar="NAME|FILE",
        help="seed002 (default), nanakuma4, or a consist",
    )
    top.add_argument("--optimal", action="store_true", help="compare with the optimal control")
    top.add_argument(
        "--receptive",
        type=_share,
        default=1.0,
        metavar="RATIO",
        help="share of the regenerated energy that is used; default: 1",
    )
    top.add_argument("--literal", action="store_true", help="also show equation (1) as printed")
    top.add_argument(
        "--out", metavar="DIR", help="folder for figure and results; default: a folder below runs/"
    )
    top.add_argument("--json", action="store_true", help="one JSON object on standard output")
    return top


def main(argv: Sequence[str]) -> int:
    """Run the command; every error of the user becomes one line, never a traceback."""
    options = parser().parse_args(argv)
    try:
        return _design(options)
    except (SettingsError, RunFolderError) as error:
        print(f"vobc: {error}", file=sys.stderr)
        return EXIT_USAGE
    except NotSolvedError as error:
        print(
            f"vobc: --optimal: {error}; give more --time, or leave --optimal out", file=sys.stderr
        )
        return EXIT_FAILED


def _design(options: argparse.Namespace) -> int:
    line, train = load_line(options.line), load_train(options.train)
    first, last, track = track_between(line, train, options.start, options.end)
    coarse = track_between(line, train, first, last, cell_m=OPTIMUM_CELL_M)[2]
    asked = DesignRequest(
        Hop(train, with_thrift(train, track, options.receptive)),
        coarse,
        time_s=options.time,
        weight_factor=options.eta,
        use_ratio=options.receptive,
        optimal=options.optimal,
        literal=options.literal,
    )
    folder = make_run_folder(options.out, WallClock().epoch_ns(), f"curve_{first}-{last}")
    try:
        found = answer(asked)
    except (SettingsError, NotSolvedError):
        discard_unused(folder)
        raise
    console = console_for(json=options.json)
    title = f"{line.name}: {first} to {last}, {track.length_m:g} m in {options.time:g} s"
    _show(console, title, found)
    if options.train == "seed002":
        _show_table_one(console, train)
    picture = folder.path / "curve.png"
    _draw(picture, title, found)
    told = json.dumps({"line": line.name, "from": first, "to": last, **as_document(found)})
    write_whole(folder.path / "results.json", told + "\n")
    console.print(f"picture: {picture}", highlight=False, soft_wrap=True)
    if options.json:
        print(told)
    return EXIT_OK


def _show(console: Console, title: str, found: DesignAnswer) -> None:
    asked, curve, choice = found.asked, found.designed.curve, found.designed.choice
    table = Table("", "", title=title, show_header=False)
    table.add_row("weight factor", f"{asked.weight_factor:g}")
    table.add_row(
        "x, of T0..T", f"{choice.x_s:.2f} s, of {choice.fastest_s:.2f}..{asked.time_s:g} s"
    )
    table.add_row(*_speed_row(found))
    motor_kw = curve.power_w / asked.train.motors / 1000.0
    table.add_row(
        "power limit of the brake", f"{motor_kw:.2f} kW a motor, {curve.power_w / 1e3:.0f} kW"
    )
    table.add_row(
        "braking point", f"{curve.braking_at_m:.1f} m, at {curve.braking_from_mps:.2f} m/s"
    )
    table.add_row("running time", f"{curve.time_s:.2f} s, of it braking {curve.braking_s:.2f} s")
    for name, energy_j in (
        ("acceleration energy", curve.acceleration_j),
        ("regenerated energy", curve.regenerated_j),
        (f"total, {asked.use_ratio:.0%} used", curve.total_j(asked.use_ratio)),
    ):
        table.add_row(name, f"{energy_j / J_PER_MJ:.2f} MJ = {energy_j / J_PER_KWH:.2f} kWh")
    if found.designed.late_s > 0.01:
        table.add_row("late", f"{found.designed.late_s:.2f} s even with the full brake")
    _add_optimum(table, found)
    _add_literal(table, found)
    console.print(table)


def _speed_row(found: DesignAnswer) -> tuple[str, str]:
    asked, curve = found.asked, found.designed.curve
    if asked.track.thrift is not None:
        top_mps = float(np.max(found.run.speed_mps))
        coasts_m = int(np.sum(found.run.power_w == 0.0)) * asked.track.cell_m
        text = f"{top_mps:.2f} m/s ({top_mps * KMH_PER_MPS:.1f} km/h)"
        return "greatest speed", f"{text}, coasts for {coasts_m:.0f} m of the way"
    notch = f"{curve.notch_off_mps:.2f} m/s ({curve.notch_off_mps * KMH_PER_MPS:.1f} km/h)"
    held = f", held for {curve.hold_m:.0f} m" if curve.hold_m > 0.0 else ""
    return "notch-off speed", notch + held


def _add_optimum(table: Table, found: DesignAnswer) -> None:
    best = found.optimum
    if best is None or found.above_ratio is None:
        return
    table.add_section()
    words = f"{best.cost_j / J_PER_MJ:.2f} MJ in {best.time_s:.2f} s"
    table.add_row("optimal control, E_acc - k E_reg", words)
    table.add_row("of it by friction", f"{best.friction_j / J_PER_MJ:.2f} MJ braked away")
    table.add_row("excess of the designed run", f"{100.0 * found.above_ratio:.2f} %")


def _add_literal(table: Table, found: DesignAnswer) -> None:
    printed = found.literal
    if printed is None:
        return
    table.add_section()
    table.add_row("equation (1) as printed: x", f"{printed.x_s:.2f} s")
    table.add_row("its t_brake", f"{printed.asked_braking_s:.2f} s")
    when = "late" if printed.late_s > 0.0 else "early"
    table.add_row(
        "the run with that braking time",
        f"{printed.curve.power_w / found.asked.train.motors / 1e3:.1f} kW a motor, brakes "
        f"{printed.curve.braking_s:.2f} s, is {abs(printed.late_s):.2f} s {when}",
    )
    implied_s = x_that_the_table_implies_s(table_one.TIME_S, table_one.TABLE_I[-1].braking_s)
    table.add_row(
        "x that row (I) of Table I implies",
        f"{implied_s:.2f} s; 1 km takes {found.designed.choice.fastest_s:.2f} s at least"
        if math.isclose(found.asked.track.length_m, table_one.LENGTH_M)
        else f"{implied_s:.2f} s",
    )


def _show_table_one(console: Console, train: RunningTrain) -> None:
    rows = table_one.rows(train)
    table = Table(
        *("η", "kW/motor", "E_acc MJ", "E_reg MJ", "total MJ", "t_brake s", "T s", "8·P·t_b kWh"),
        title="Table I: runs of 1 km in 72.5 s at the paper's power limits / as printed",
    )
    for row in rows:
        printed, curve = row.printed, row.curve
        table.add_row(
            f"{printed.weight_factor:g}",
            f"{printed.power_kw:g}",
            f"{curve.acceleration_j / J_PER_MJ:.2f} / {printed.acceleration_kwh:g}",
            f"{curve.regenerated_j / J_PER_MJ:.2f} / {printed.regenerated_kwh:g}",
            f"{curve.total_j(1.0) / J_PER_MJ:.2f} / {printed.total_kwh:g}",
            f"{curve.braking_s:.2f} / {printed.braking_s:g}",
            f"{curve.time_s:.2f}",
            f"{row.regenerable_max_kwh():.2f}",
        )
    console.print(table)
    hop = Hop(train, level_track(train, table_one.LENGTH_M))
    designed = ", ".join(f"{each_kw:.1f}" for each_kw in table_one.designed_kw(hop))
    console.print(f"designed limits, kW/motor, by η as above: {designed}", highlight=False)
    in_mj = table_one.deviation_ratio(rows, unit_j=J_PER_MJ)
    in_kwh = table_one.deviation_ratio(rows, unit_j=J_PER_KWH)
    kwh = ", ".join(
        f"{row.curve.acceleration_j / J_PER_KWH:.2f}/{row.curve.regenerated_j / J_PER_KWH:.2f}"
        for row in rows
    )
    console.print(f"the same in kWh, E_acc/E_reg: {kwh}", highlight=False)
    console.print(
        f"15 cells: {100.0 * in_mj:.2f} % rms with the printed numbers in MJ, "
        f"{100.0 * in_kwh:.0f} % in kWh, which the paper says. No brake gives back more than "
        "8·P·t_b, so the printed E_reg cannot be kWh.",
        highlight=False,
    )
    console.print(
        f"declared train: {train.mass_kg / 1e3:g} t, traction {train.traction_force_n / 1e3:g} kN "
        f"and {train.traction_power_w / train.motors / 1e3:g} kW a motor, electric brake "
        f"{train.brake_force_n / 1e3:g} kN and {train.brake_power_w / train.motors / 1e3:g} kW a "
        f"motor, efficiency {train.traction_efficiency_ratio:g} and "
        f"{train.regeneration_efficiency_ratio:g}, "
        f"resistance {train.resistance_n:g} + {train.resistance_n_per_mps:g} v + "
        f"{train.resistance_n_per_mps2:g} v² N",
        highlight=False,
    )


def _draw(out: Path, title: str, found: DesignAnswer) -> None:
    # The drawing libraries load slowly, so they are imported only for the figure.
    from metro_hil.energy.running_curve import figures

    asked = found.asked
    net = net_of(asked)
    conventional, economical = reference_curves(asked)
    energies_j, powers_w = sweep_of(net, asked.time_s)
    figures.draw(
        out,
        figures.Page(
            title=f"{title}, weight {asked.weight_factor:g}, {asked.train.description}",
            train=asked.train,
            use_ratio=asked.use_ratio,
            net=net,
            designed=found.designed,
            conventional=conventional,
            economical=economical,
            traces=(
                ("<I>", figures.CONVENTIONAL, trace(asked.train, asked.track, conventional)),
                ("<II>", figures.ECONOMICAL, trace(asked.train, asked.track, economical)),
                ("designed", figures.DESIGNED, found.run),
            ),
            sweep=figures.Sweep(SWEEP, tuple(energies_j), tuple(powers_w)),
            optimum=found.optimum,
        ),
    )


def _positive(text: str) -> float:
    value = _number(text)
    if not 0.0 < value < math.inf:
        raise argparse.ArgumentTypeError(f"{text} is not more than 0")
    return value


def _weight(text: str) -> float:
    value = _number(text)
    if not 0.0 <= value < math.inf:
        raise argparse.ArgumentTypeError(f"{text} is not 0 or more")
    return value


def _share(text: str) -> float:
    value = _number(text)
    if not 0.0 <= value <= 1.0:
        raise argparse.ArgumentTypeError(f"{text} is not within 0..1")
    return value


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is not a number") from None
