"""`vobc run --lockstep --trains N`: a line of trains with their controllers, on its network."""

import json
import sys
from pathlib import Path
from typing import Any, Final

from rich.console import Console
from rich.table import Table

from canlog.run_names import mark_latest
from firmware_py.clock.clock import WallClock
from firmware_py.interrupts import Interrupts
from firmware_py.storage.recorder import loss_text
from firmware_py.storage.whole_file import write_whole
from metro_hil.line.virtual.coordinator import LineRecord, TrainDiedError, conduct
from metro_hil.line.virtual.member import LinePlan, VirtualTrainReport, plan_line
from metro_hil.model.end_condition import DURATION, INTERRUPTED
from metro_hil.model.run_folder import make_run_folder, plain, write_config
from metro_hil.model.run_options import (
    EXIT_ENVIRONMENT,
    EXIT_FAILED,
    EXIT_INTERRUPTED,
    EXIT_OK,
    RunOptions,
)

J_PER_KWH: Final = 3.6e6
DURATION_S: Final = 1260.0
"""Duration of one lap."""
ON_TIME_S: Final = 2.0
PERCENT: Final = 100.0


def run(options: RunOptions, console: Console) -> int:
    """Run the line and write its results. Raises SettingsError, RunFolderError."""
    assert options.trains is not None
    plan = plan_line(
        line=options.line,
        trains=options.trains,
        consist=options.consist,
        params=options.params,
        seed=options.seed,
        law=options.ato,
        supply=options.supply,
        traffic=options.traffic,
        cycle_ms=options.cycle_ms,
        stage=options.output,
        load_ratio=options.load_ratio,
        odometer_error_ratio=options.odometer_error,
    )
    duration_s = DURATION_S if options.duration_s is None else options.duration_s
    clock = WallClock()
    folder = make_run_folder(options.out, clock.epoch_ns(), f"{plan.line.name}_{options.trains}")
    write_config(folder, {"options": options, "traffic": plan.traffic}, clock.epoch_ns())
    mark_latest(folder.path)
    folders = [_train_folder(folder.path, plan, n, options.logs) for n in range(options.trains)]
    began_ns = clock.now_ns()
    interrupts = Interrupts()
    try:
        with interrupts.caught(), console.status("the first second") as status:
            record = conduct(
                plan,
                duration_s,
                folders=folders,
                told=lambda now_s: status.update(f"{now_s:.0f} s of {duration_s:.0f} s"),
                interrupted=lambda: interrupts.asked,
            )
    except TrainDiedError as error:
        console.print(f"vobc: {error}", style="red", highlight=False)
        return EXIT_FAILED
    if not record.rows:
        print("vobc: ended before the first interval was over", file=sys.stderr)
        return EXIT_INTERRUPTED
    factor = record.duration_s * 1e9 / max(1, clock.now_ns() - began_ns)
    reason = INTERRUPTED if interrupts.asked else DURATION
    document = as_document(plan, record, reason)
    _show(console, record, document, factor)
    write_whole(folder.results, json.dumps(document, indent=2) + "\n")
    from metro_hil.line.virtual import figures

    figures.draw(folder.path / "line.png", plan, record, plan.config.ato.strategy)
    console.print(f"plot: {folder.path / 'line.png'}", highlight=False, soft_wrap=True)
    console.print(f"run folder: {folder.path}", highlight=False, soft_wrap=True)
    if options.json:
        print(json.dumps(document))
    if lost := sum(report.lost_log_lines for report in record.reports):
        print(f"vobc: {folder.path}: {loss_text(lost)}", file=sys.stderr)
        return EXIT_ENVIRONMENT
    if interrupts.asked:
        return EXIT_INTERRUPTED
    sound = not document["emergencies"] and not record.unconverged
    return EXIT_OK if sound else EXIT_FAILED


def _on_time(document: dict[str, Any]) -> str:
    if not document["runs"]:
        return "no run came to its end"
    return f"{document['on_time_ratio']:.1%} of {document['runs']} runs within {ON_TIME_S:g} s"


def _train_folder(path: Path, plan: LinePlan, index: int, logs: bool) -> Path | None:
    if not logs:
        return None
    folder = path / f"train{plan.starts[index].train}"
    folder.mkdir()
    return folder


def as_document(plan: LinePlan, record: LineRecord, exit_reason: str) -> dict[str, Any]:
    """Return the results for JSON, equal for equal seeds on any machine."""
    books = record.books
    runs = [run for report in record.reports for run in report.runs]
    on_time = [abs(run.late_s) <= ON_TIME_S for run in runs]
    used_j = books.regenerated_j - books.resistor_j
    return {
        "line": plan.line.name,
        "trains": len(plan.starts),
        "law": plan.config.ato.strategy,
        "supply": plan.supply.name,
        "seed": plan.seed,
        "exit_reason": exit_reason,
        "duration_s": record.duration_s,
        "actual_kwh": books.sources_j / J_PER_KWH,
        "returned_kwh": books.returned_j / J_PER_KWH,
        "storages_kwh": books.storages_j / J_PER_KWH,
        "overall_kwh": (books.sources_j + used_j) / J_PER_KWH,
        "traction_kwh": books.traction_j / J_PER_KWH,
        "auxiliary_kwh": books.auxiliary_j / J_PER_KWH,
        "regenerated_kwh": books.regenerated_j / J_PER_KWH,
        "resistor_kwh": books.resistor_j / J_PER_KWH,
        "use_ratio": used_j / max(1.0, books.traction_j),
        "lowest_v": books.lowest_v,
        "highest_v": books.highest_v,
        "closure_ratio": books.closure_ratio,
        "metered_ratio": _metered_ratio(record),
        "unconverged": record.unconverged,
        "solved": record.solved,
        "runs": len(runs),
        "on_time_ratio": sum(on_time) / max(1, len(on_time)),
        "worst_late_s": max((abs(run.late_s) for run in runs), default=0.0),
        "worst_stop_m": max((abs(run.error_m) for run in runs), default=0.0),
        "least_gap_m": record.least_gap_m if len(plan.starts) > 1 else None,
        "emergencies": sum(report.emergencies for report in record.reports),
        "per_train": [_of_train(report) for report in record.reports],
    }


def _metered_ratio(record: LineRecord) -> float:
    """Return the relative difference between the trains' own energy meters and the network's."""
    metered_j = sum(report.drawn_j - report.returned_j for report in record.reports)
    return (metered_j - record.books.trains_j) / max(1.0, abs(record.books.trains_j))


def _of_train(report: VirtualTrainReport) -> dict[str, Any]:
    return {
        "train": report.train,
        "frames": report.frames,
        "frame_chain": report.frame_chain,
        "emergencies": report.emergencies,
        "drawn_kwh": report.drawn_j / J_PER_KWH,
        "returned_kwh": report.returned_j / J_PER_KWH,
        "resistor_kwh": report.resistor_j / J_PER_KWH,
        "lost_log_lines": report.lost_log_lines,
        "runs": [plain(run._asdict()) for run in report.runs],
    }


def _show(console: Console, record: LineRecord, document: dict[str, Any], factor: float) -> None:
    table = Table("train", "stops", "worst stop", "worst run", "drawn", "returned", "resistor")
    for report in record.reports:
        worst_m = max((abs(run.error_m) for run in report.runs), default=0.0)
        late = sorted((run.late_s for run in report.runs), key=abs)
        table.add_row(
            str(report.train),
            str(len(report.runs)),
            f"{worst_m * 100.0:.1f} cm",
            f"{late[-1]:+.1f} s" if late else "–",
            *(
                f"{joules / J_PER_KWH:.1f} kWh"
                for joules in (report.drawn_j, report.returned_j, report.resistor_j)
            ),
        )
    console.print(table)
    gap = document["least_gap_m"]
    parts = [
        f"from the grid {document['actual_kwh']:.1f} kWh, regeneration used "
        f"{document['use_ratio']:.1%} of traction",
        _on_time(document),
        f"{document['emergencies']} emergency brakes",
        *([] if gap is None else [f"least gap {gap:.0f} m"]),
        f"pantographs {document['lowest_v']:.0f} to {document['highest_v']:.0f} V",
        f"{document['unconverged']} of {document['solved']} instants without a network solution",
        f"energy balance closes within {PERCENT * abs(document['closure_ratio']):.4f} %",
        f"meters within {PERCENT * abs(document['metered_ratio']):.3f} %",
        f"{factor:.0f} times real time",
    ]
    console.print("; ".join(parts), highlight=False)
