"""`make bench-stops`: stops over the declared envelope of trains and lines, law by law.

Each row is one departure from the train that the controller assumes. Jogs and emergency brakes
count as failures, because passengers notice them even if the doors open in the end.
"""

import argparse
import json
import math
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from importlib import resources
from pathlib import Path
from typing import Any, Final

from rich.table import Table

from metro_hil.benchmarks.campaigns import ran
from metro_hil.engine.folder import CampaignFolder
from metro_hil.engine.journal import read_journal
from metro_hil.model.case import Case, CaseResult
from metro_hil.model.run_options import EXIT_OK
from metro_hil.model.terminal import console_for
from metro_hil.report.law_figures import LawFigures, figures_of, law_of, stops_m

LAWS: Final = ("predictive", "pid", "chasing")
SEEDS: Final = 10
CM_PER_M: Final = 100.0
PERCENT: Final = 100.0
WINDOW_M: Final = 0.30
"""Greatest stopping error at which doors may open."""
LINES: Final = "campaign/shipped/lines"
HEAD: Final = (
    *("row", "law", "stops", "mean cm", "worst cm", "bound cm", "in 30 cm %"),
    *("jogs", "emergencies", "doors shut", "stranded", "over the shortest %"),
)


@dataclass(frozen=True, slots=True)
class Row:
    """One kind of departure from the assumed train."""

    name: str
    real: Mapping[str, Any] = field(default_factory=dict)
    """Overrides of the consist."""
    train: Mapping[str, Any] = field(default_factory=dict)
    """Other keys of the campaign's train."""
    faults: tuple[Mapping[str, Any], ...] = ()


def _brake(key: str, value: float) -> dict[str, Any]:
    return {f"brake.service.{key}.low": value, f"brake.service.{key}.high": value}


def _slope(line: str, start: str, end: str) -> dict[str, Any]:
    return {"line": f"{line}.toml", "start": start, "end": end}


ENVELOPE: Final = (
    Row("as assumed"),
    *(Row(f"brake gain {gain:g}", _brake("gain_ratio", gain)) for gain in (0.75, 0.8, 1.2, 1.25)),
    *(Row(f"dead time {time_s:g} s", _brake("dead_time_s", time_s)) for time_s in (0, 1.8, 2.5, 3)),
    Row(
        "dead time 1 s on application only",
        {**_brake("dead_time_s", 1.0), "brake.service.dead_time_kind": "application"},
    ),
    *(Row(f"lag {lag_s:g} s", _brake("lag_s", lag_s)) for lag_s in (0.2, 1.2)),
    *(Row(f"load reported {ratio:g} times", {"load_report_ratio": ratio}) for ratio in (0.0, 1.5)),
    Row("stop on +30 ‰", train=_slope("slopes", "Slope", "Climb")),
    Row("stop on -30 ‰", train=_slope("slopes", "Foot", "Slope")),
    Row("stop on +45 ‰", train=_slope("climb", "Lower", "Upper")),
    Row("adhesion 0.06", faults=({"kind": "low_adhesion", "adhesion_ratio": 0.06},)),
    Row("radar lost under way", faults=({"kind": "doppler_outage", "when": "front_m > 3100"},)),
    Row("T3 unread", faults=({"kind": "tag_missed", "tag_id": 303},)),
    *(Row(f"cycle {cycle_ms:g} ms", train={"cycle_ms": cycle_ms}) for cycle_ms in (20.0, 200.0)),
)


def campaign_text(rows: Sequence[Row], laws: Sequence[str], seeds: int, lines: Path) -> str:
    """The campaign file: one scenario a row, for each law."""
    parts = [
        'title = "Envelope"',
        "stop_at_violation = false",
        'invariants = "none"',
        f"seeds = {seeds}",
        f'[each]\n"train.believed.ato.strategy" = {_value(list(laws))}',
        '[train]\nline = "florence"\nstart = "II"\nend = "III"\nduration_s = 300.0',
        '[[monitor]]\nname = "stops"\nmeasure = "stops_missed_count"\nmax = 0.0',
    ]
    for number, row in enumerate(rows):
        train = dict(row.train)
        if "line" in train:
            train["line"] = str(lines / train["line"])
        parts += [f'[[scenario]]\nname = "row-{number}"\ntitle = {_value(row.name)}']
        parts += [f"fault = {_value(list(row.faults))}"] if row.faults else []
        parts += ["[scenario.train]", *(f"{key} = {_value(train[key])}" for key in train)]
        if row.real:
            parts += ["[scenario.train.real]"]
            parts += [f'"{key}" = {_value(value)}' for key, value in row.real.items()]
    return "\n".join(parts) + "\n"


def _value(value: object) -> str:
    """A value of TOML."""
    if isinstance(value, Mapping):
        return "{ " + ", ".join(f"{key} = {_value(one)}" for key, one in value.items()) + " }"
    if isinstance(value, list):
        return "[" + ", ".join(map(_value, value)) + "]"
    return json.dumps(value, ensure_ascii=False)


def cells(row: str, law: str, pairs: Sequence[tuple[Case, CaseResult | None]]) -> tuple[str, ...]:
    """One row of the table."""
    figures: LawFigures = figures_of(pairs)
    results = [result for _, result in pairs if result is not None]
    errors_m = [error_m for result in results for error_m in stops_m(result)]
    within = sum(error_m is not None and abs(error_m) <= WINDOW_M for error_m in errors_m)
    return (
        row,
        law,
        f"{figures.stops - figures.missed}/{figures.stops}",
        _scaled(figures.mean_m, CM_PER_M, ".1f"),
        _scaled(figures.worst_m, CM_PER_M, "+.1f"),
        _scaled(figures.bound_m, CM_PER_M, ".0f"),
        f"{within / len(errors_m) * PERCENT:.0f}" if errors_m else "–",
        f"{_sum(results, 'jogs_count'):.0f}",
        f"{_sum(results, 'emergency_count'):.0f}",
        f"{_sum(results, 'doors_shut_count'):.0f}",
        f"{_sum(results, 'stranded_count'):.0f}",
        _scaled(figures.over_ratio, PERCENT, ".1f"),
    )


def _sum(results: Sequence[CaseResult], measure: str) -> float:
    return math.fsum(result.measures.get(measure) or 0.0 for result in results)


def _scaled(value: float | None, factor: float, form: str) -> str:
    return "–" if value is None else format(value * factor, form)


def measured(rows: Sequence[Row], laws: Sequence[str], seeds: int) -> list[tuple[str, ...]]:
    """Run the campaign as a user does, and make the table's rows."""
    with (
        tempfile.TemporaryDirectory() as folder,
        resources.as_file(resources.files("metro_hil") / LINES) as lines,
    ):
        scratch = Path(folder)
        campaign = scratch / "envelope.toml"
        campaign.write_text(campaign_text(rows, laws, seeds, lines), encoding="utf-8")
        ran(scratch, str(campaign))
        out = CampaignFolder(scratch / "run0")
        results = {result.case_id: result for result in read_journal(out.journal_path).results}
        pairs = [(case, results.get(case.id)) for case in out.cases()]
    table = []
    for number, row in enumerate(rows):
        for law in laws:
            scenario = f"row-{number}-{law}"
            own = [(c, r) for c, r in pairs if c.scenario == scenario and law_of(c) == law]
            table.append(cells(row.name, law, own))
    return table


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="make bench-stops", description=__doc__)
    parser.add_argument("words", nargs="*", help="rows to measure, by a word of their names")
    parser.add_argument("--laws", nargs="+", default=list(LAWS), metavar="LAW")
    parser.add_argument("--seeds", type=int, default=SEEDS, help="runs of each row and law")
    options = parser.parse_args(argv)
    words = options.words
    rows = [row for row in ENVELOPE if not words or any(word in row.name for word in words)]
    if not rows:
        parser.error(f"no row has {' or '.join(words)} in its name")
    table = Table(title="Stops over the envelope", box=None)
    for name in HEAD:
        table.add_column(name, justify="left" if name in HEAD[:2] else "right", overflow="fold")
    for each in measured(rows, options.laws, options.seeds):
        table.add_row(*each)
    console_for().print(table)
    return EXIT_OK


if __name__ == "__main__":
    raise SystemExit(main())
