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
from metro_hil.line.energy import (
    COLUMNS,
    cells_of,
    keys_of_network,
    keys_of_train,
    section_table,
    summary_of,
)
from metro_hil.line.virtual.coordinator import LineRecord, TrainDiedError, conduct
from metro_hil.line.virtual.member import LinePlan, VirtualTrainReport, plan_line
from metro_hil.metrics.hops import hop_table, means_of
from metro_hil.model.end_condition import DURATION, INTERRUPTED
from metro_hil.model.run_folder import make_run_folder, plain, write_config
from metro_hil.model.run_options import (
    EXIT_ENVIRONMENT,
    EXIT_FAILED,
    EXIT_INTERRUPTED,
    EXIT_OK,
    RunOptions,
)

DURATION_S: Final = 1260.0
"""Duration of one lap."""
ON_TIME_S: Final = 2.0


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
    if options.hops:
        console.print(hop_table(document["hops"]))
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
    sound = not document["emergencies"] and not document["unconverged"]
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
    energies = [report.energy for report in record.reports]
    runs = [run for report in record.reports for run in report.runs]
    on_time = [abs(run.late_s) <= ON_TIME_S for run in runs]
    return {
        "line": plan.line.name,
        "trains": len(plan.starts),
        "law": plan.config.ato.strategy,
        "supply": plan.supply.name,
        "seed": plan.seed,
        "exit_reason": exit_reason,
        "duration_s": record.duration_s,
        **keys_of_network(record.coupling, energies),
        "hops": means_of([hop for report in record.reports for hop in report.hops]),
        "runs": len(runs),
        "on_time_ratio": sum(on_time) / max(1, len(on_time)),
        "worst_late_s": max((abs(run.late_s) for run in runs), default=0.0),
        "worst_stop_m": max((abs(run.error_m) for run in runs), default=0.0),
        "least_gap_m": record.least_gap_m if len(plan.starts) > 1 else None,
        "emergencies": sum(report.emergencies for report in record.reports),
        "per_train": [_of_train(report) for report in record.reports],
    }


def _of_train(report: VirtualTrainReport) -> dict[str, Any]:
    return {
        "train": report.train,
        "frames": report.frames,
        "frame_chain": report.frame_chain,
        "emergencies": report.emergencies,
        **keys_of_train(report.energy),
        "lost_log_lines": report.lost_log_lines,
        "runs": [plain(run._asdict()) for run in report.runs],
    }


def _show(console: Console, record: LineRecord, document: dict[str, Any], factor: float) -> None:
    table = Table("train", "stops", "worst stop", "worst run", *COLUMNS)
    for report in record.reports:
        worst_m = max((abs(run.error_m) for run in report.runs), default=0.0)
        late = sorted((run.late_s for run in report.runs), key=abs)
        table.add_row(
            str(report.train),
            str(len(report.runs)),
            f"{worst_m * 100.0:.1f} cm",
            f"{late[-1]:+.1f} s" if late else "–",
            *cells_of(report.energy),
        )
    console.print(table)
    if document["sections"]:
        console.print(section_table(document["sections"]))
    gap = document["least_gap_m"]
    parts = [
        _on_time(document),
        f"{document['emergencies']} emergency brakes",
        *([] if gap is None else [f"least gap {gap:.0f} m"]),
        *summary_of(document),
        f"{factor:.0f} times real time",
    ]
    console.print("; ".join(parts), highlight=False)
