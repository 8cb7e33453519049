"""Renders one self-contained page from all data of a campaign."""

from collections.abc import Sequence
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import Any, Final

from jinja2 import DictLoader, Environment, StrictUndefined
from markupsafe import Markup

from metro_hil.campaign.coverage import Coverage, coverage
from metro_hil.report.campaign.info import CampaignInfo
from metro_hil.report.campaign.ledger import Ledger
from metro_hil.report.campaign.page.matrix import (
    SCENARIOS_MAX,
    SQUARES_MAX,
    SYMBOLS,
    scenario_view,
)
from metro_hil.report.campaign.page.sections import (
    FAILURES_MAX,
    failure_views,
    measure_views,
    monitor_views,
    picture,
    worst_views,
)
from metro_hil.report.campaign.requirement_table import RequirementRow
from metro_hil.report.campaign.tally import MeasureTally, MonitorTally
from metro_hil.report.campaign.trace import RequirementStanding
from metro_hil.report.campaign.units import number_text, percent_text
from metro_hil.report.estimates import ConfidenceInterval, pass_share
from metro_hil.report.layouts.tables import LayoutFigure, LayoutTable

TEMPLATES: Final = "metro_hil.report.campaign.templates"
GAPS_SHOWN: Final = 15


@dataclass(frozen=True, slots=True)
class Content:
    """All data that the page shows."""

    info: CampaignInfo
    ledger: Ledger
    monitors: Sequence[MonitorTally]
    measures: Sequence[MeasureTally]
    requirements: Sequence[RequirementRow]
    layout: Sequence[LayoutTable]
    figures: Sequence[LayoutFigure] = ()


def render_page(folder: Path, content: Content) -> str:
    """HTML with everything inline; names are escaped everywhere."""
    environment = Environment(
        loader=DictLoader({name: _template(name) for name in ("report.html", "cases.html")}),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters.update(number=number_text, percent=percent_text, interval=_interval)
    page = environment.get_template("report.html").render(_context(folder, content))
    return page.rstrip() + "\n"


def _context(folder: Path, content: Content) -> dict[str, Any]:
    info, ledger = content.info, content.ledger
    scenarios = list(ledger.scenarios().items())
    single = len(ledger.entries) <= SQUARES_MAX
    measures = measure_views(ledger, content.measures)
    return {
        "style": Markup(_template("style.css")),  # noqa: S704
        "script": Markup(_template("script.js")),  # noqa: S704
        "info": info,
        "ledger": ledger,
        "symbols": SYMBOLS,
        "share": pass_share(ledger.as_expected, ledger.expected_cases),
        "sim_s": sum(e.result.sim_s for e in ledger.entries if e.result is not None),
        "frames": sum(e.result.frames for e in ledger.entries if e.result is not None),
        "single": single,
        "scenarios": [scenario_view(n, e, single=single) for n, e in scenarios[:SCENARIOS_MAX]],
        "scenarios_left_out": max(0, len(scenarios) - SCENARIOS_MAX),
        "monitors": monitor_views(content.monitors),
        "drawn": [view for view in measures if view.whole is not None],
        "listed": [view for view in measures if view.whole is None],
        "worst": worst_views(folder, ledger, content.monitors),
        "failures": failure_views(folder, ledger),
        "failures_max": FAILURES_MAX,
        "coverage": _coverage(ledger),
        "gaps_shown": GAPS_SHOWN,
        "requirements": [row for row in content.requirements if row.run],
        "open": [row for row in content.requirements if row.standing is RequirementStanding.OPEN],
        "remarks": ledger.remarks(),
        "layout": content.layout,
        "figures": [(each.caption, picture(each.path, each.caption)) for each in content.figures],
    }


def _coverage(ledger: Ledger) -> Coverage:
    results = [entry.result for entry in ledger.entries if entry.result is not None]
    return coverage([entry.case for entry in ledger.entries], results, 2)


def _interval(interval: ConfidenceInterval | None, percent: bool = False) -> str:
    """The best value, then the interval; a share in per cent."""
    if interval is None:
        return "–"
    text = percent_text if percent else number_text
    return f"{text(interval.best)} [{text(interval.low)}, {text(interval.high)}]"


def _template(name: str) -> str:
    return files(TEMPLATES).joinpath(name).read_text(encoding="utf-8")
