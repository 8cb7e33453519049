"""The closing table of one run."""

import math

from rich.console import Console
from rich.table import Table
from rich.text import Text

from metro_hil.metrics.comfort import Comfort
from metro_hil.metrics.results import RunResults
from metro_hil.metrics.stops import StationStop

TOLERANCE_M = 0.10
"""Stopping tolerance of [Allotta 2013], table 1."""
ACCEL_MPS2 = 0.8
JERK_MPS3 = 0.6


def print_results(console: Console, results: RunResults) -> None:
    """Print tables of stops, motion, protection and timing, as far as there are values."""
    _print_stops(console, results)
    table = Table.grid(padding=(0, 2))
    table.add_column(style="dim", justify="right")
    table.add_column()
    for name, text in _rows(results):
        table.add_row(name, text)
    console.print(table)
    _print_events(console, results)


def _print_stops(console: Console, results: RunResults) -> None:
    if not results.stops:
        return
    table = Table(title="stops", title_justify="left", title_style="bold")
    for name in ("station", "stop error", "run time", "verdict"):
        table.add_column(name, justify="left" if name in ("station", "verdict") else "right")
    for stop in results.stops:
        if stop.error_m is None or stop.run_time_s is None:
            table.add_row(stop.station, "-", "-", Text("not reached", style="yellow"))
            continue
        inside = abs(stop.error_m) <= TOLERANCE_M
        text = "within ±10 cm" if inside else "outside ±10 cm"
        table.add_row(
            stop.station,
            f"{stop.error_m * 100.0:+.1f} cm",
            f"{stop.run_time_s:.1f} s",
            Text(text + _jogged(stop), style="green" if inside and not stop.jogs else "red"),
        )
    console.print(table)


def _jogged(stop: StationStop) -> str:
    """What followed a stop that jogs corrected."""
    if not stop.jogs:
        return ""
    jogs = "1 jog" if stop.jogs == 1 else f"{stop.jogs} jogs"
    if stop.doors_error_m is None:
        return f", {jogs}, doors shut"
    return f", {jogs}, doors open at {stop.doors_error_m * 100.0:+.1f} cm"


def _rows(results: RunResults) -> list[tuple[str, str]]:
    rows = [("ended", results.exit_reason)]
    if results.ride and not results.truth_known:
        rows.append(
            ("measured by", "the controller's own odometry: this plant logs no true values")
        )
    if results.ride:
        rows += [
            ("distance", f"{results.ride.distance_m:.1f} m in {results.ride.duration_s:.1f} s"),
            ("top speed", f"{results.ride.top_speed_mps * 3.6:.1f} km/h"),
            ("max acceleration", _against(results.ride.max_accel_mps2, ACCEL_MPS2, "m/s²")),
            ("max jerk", _against(results.ride.max_jerk_mps3, JERK_MPS3, "m/s³")),
        ]
    rows += _comfort(results.comfort)
    if results.cycles:
        rows += _rhythm(results)
    rows.append(("bus", f"{results.frames} frames, mean load {results.bus_load_ratio * 100:.1f} %"))
    rejected = sum(results.rejected_frames.values())
    if rejected:
        rows.append(("rejected frames", str(rejected)))
    for name, count in (
        ("frames not logged", results.dropped_frames),
        ("log lines lost", results.lost_log_lines),
    ):
        if count:
            rows.append((name, str(count)))
    if results.real_time_factor is not None:
        rows.append(("real-time factor", f"{results.real_time_factor:.0f} times"))
    return rows


def _comfort(comfort: Comfort) -> list[tuple[str, str]]:
    """Rows of the known comfort values; none for a plant without truth log."""
    asked = (
        (comfort.commanded_accel_max_mps2, ACCEL_MPS2, "m/s²"),
        (comfort.commanded_jerk_max_mps3, JERK_MPS3, "m/s³"),
    )
    felt = (
        (comfort.felt_accel_max_mps2, "m/s²"),
        (comfort.felt_jerk_1s_mps3, "m/s³ over 1 s"),
        (comfort.felt_jerk_2hz_mps3, "m/s³ at 2 Hz"),
    )
    rows = []
    words = [f"{v:.2f} {unit} (design {most} {unit})" for v, most, unit in asked if v is not None]
    if words:
        rows.append(("operation asked for", ", ".join(words)))
    words = [f"{value:.2f} {unit}" for value, unit in felt if value is not None]
    if words:
        rows.append(("felt in the worst car", ", ".join(words)))
    if comfort.en12299_index_ratio is not None:
        rows.append(("EN 12299, longitudinal", f"{comfort.en12299_index_ratio:.2f}"))
    return rows


def _rhythm(results: RunResults) -> list[tuple[str, str]]:
    cycles = results.cycles
    assert cycles is not None
    rows = []
    if math.isfinite(cycles.least_margin_mps):
        margin_kmh = cycles.least_margin_mps * 3.6
        rows.append(("least margin", f"{margin_kmh:.1f} km/h to the emergency curve"))
    if results.real_time_factor is None:
        rows += [
            (
                "cycle lateness",
                f"p50 {cycles.lateness_us_p50:.0f} µs, p99 {cycles.lateness_us_p99:.0f} µs, "
                f"max {cycles.lateness_us_max:.0f} µs",
            ),
            (
                "cycle work",
                f"p50 {cycles.work_us_p50 / 1000:.2f} ms, max {cycles.work_us_max / 1000:.2f} ms",
            ),
        ]
        if results.steal_s is not None:
            rows.append(("stolen by the host", f"{results.steal_s:.2f} s of processor time"))
        rows += [("real-time measure", text) for text in results.realtime]
    rows += [("LS-BUS node", text) for text in results.nodes]
    rows.append(("cycles", f"{cycles.cycles}, {cycles.slips} slipped"))
    return rows


def _against(value: float, limit: float, unit: str) -> str:
    return f"{value:.2f} {unit} (design {limit} {unit}, low-passed at 2 Hz)"


def _print_events(console: Console, results: RunResults) -> None:
    table = Table(title="supervision events", title_justify="left", title_style="bold")
    for name in ("at", "protection", "cause"):
        table.add_column(name)
    for event in results.events:
        table.add_row(f"{event.at_s:.2f} s", event.state, event.cause)
    if results.events:
        console.print(table)
