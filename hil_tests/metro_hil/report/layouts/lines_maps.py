"""A map of each line of the board: stations, limits, heights and curves by chainage."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from firmware_py.storage.whole_file import whole_file
from firmware_py.trackdb import LineMap, load_line
from metro_hil.engine.folder import CampaignFolder
from metro_hil.model.case import Case
from metro_hil.model.log_columns import Numbers, RunLogError, read_columns
from metro_hil.report.layouts.tables import LayoutFigure
from metro_hil.report.plot import INK, KMH_PER_MPS, PERMITTED, QUIET, TRAIN

FOLDER: Final = "maps"
CURVE: Final = "#8e44ad"
GROUND: Final = "#d9d2c3"
M_PER_KM: Final = 1000.0
POINTS_MAX: Final = 3000
"""Most points of a speed curve in a map."""
NAMES_MAX: Final = 24
"""More stations than this have no name in the map."""


def draw_maps(folder: Path, cases: Sequence[Case]) -> list[LayoutFigure]:
    """Write one PNG for each line; the speed is drawn where the case has kept logs."""
    drawn = []
    files = CampaignFolder(folder).files()
    for number, case in enumerate(_first_of_each(cases)):
        line = _line(case.setup.line, files)
        path = folder / FOLDER / f"{number:02}-{line.name}.png"
        path.parent.mkdir(exist_ok=True)
        _draw(line, path, _speed(CampaignFolder(folder), case))
        length_km = (line.stations[-1].stop_m - line.stations[0].stop_m) / M_PER_KM
        caption = f"{line.name}: {len(line.stations)} stations on {length_km:.1f} km"
        drawn.append(LayoutFigure(caption, path))
    return drawn


def _first_of_each(cases: Sequence[Case]) -> list[Case]:
    """The first case of each line and train."""
    firsts: dict[tuple[str, str], Case] = {}
    for case in cases:
        firsts.setdefault((case.setup.line, case.setup.consist), case)
    return list(firsts.values())


def _line(name: str, files: Mapping[str, Path]) -> LineMap:
    """A shipped line, or the one whose file the campaign keeps, with what follows its name."""
    kept = next((file for file in files if name == file or name.startswith(f"{file}:")), "")
    return load_line(f"{files[kept]}{name[len(kept) :]}" if kept else name)


def _speed(folder: CampaignFolder, case: Case) -> tuple[Numbers, Numbers] | None:
    """Chainage and speed of the train, if the logs of the case are kept."""
    try:
        truth = read_columns(folder.kept(case.id).truth_log)
    except (RunLogError, OSError):
        return None
    step = max(1, len(truth.numbers("t_s")) // POINTS_MAX)
    return truth.numbers("front_m")[::step], truth.numbers("speed_mps")[::step] * KMH_PER_MPS


def _draw(line: LineMap, path: Path, run: tuple[Numbers, Numbers] | None) -> None:
    with mpl.rc_context({"font.size": 9, "axes.edgecolor": QUIET, "text.color": INK}):
        figure = Figure(figsize=(13.0, 4.2), dpi=80, layout="constrained")
        FigureCanvasAgg(figure)
        speeds, heights = figure.subplots(2, 1, sharex=True, height_ratios=(3.0, 2.0))
        _draw_speeds(speeds, line, run)
        _draw_heights(heights, line)
        with whole_file(path) as part:
            figure.savefig(part, format="png")


def _draw_speeds(axes: Axes, line: LineMap, run: tuple[Numbers, Numbers] | None) -> None:
    edges_km = [section.start_m / M_PER_KM for section in line.speed_sections]
    limits_kmh = [section.limit_mps * KMH_PER_MPS for section in line.speed_sections]
    axes.stairs(limits_kmh, [*edges_km, line.end_m / M_PER_KM], color=PERMITTED, label="limit")
    if run is not None:
        at_m, speed_kmh = run
        axes.plot(at_m / M_PER_KM, speed_kmh, color=TRAIN, lw=1.0, label="train")
    for station in line.stations:
        axes.axvline(station.stop_m / M_PER_KM, color=QUIET, lw=0.7, ls=":")
    if len(line.stations) <= NAMES_MAX:
        axes.secondary_xaxis("top").set_xticks(
            [station.stop_m / M_PER_KM for station in line.stations],
            [station.name for station in line.stations],
            rotation=30,
            ha="left",
        )
    axes.set_ylim(0.0, 1.15 * max(limits_kmh))
    axes.set_ylabel("speed, km/h")
    axes.legend(frameon=False, loc="lower right", ncols=2)


def _draw_heights(axes: Axes, line: LineMap) -> None:
    edges_m = sorted(
        {line.start_m, line.end_m, *(m for g in line.gradients for m in (g.start_m, g.end_m))}
    )
    heights_m = [line.height_m(at_m) for at_m in edges_m]
    low_m, high_m = min(heights_m), max(heights_m)
    room_m = max(1.0, 0.1 * (high_m - low_m))
    edges_km = [at_m / M_PER_KM for at_m in edges_m]
    axes.fill_between(edges_km, heights_m, low_m - room_m, color=GROUND, lw=0.0)
    axes.plot(edges_km, heights_m, color=INK, lw=1.0)
    for curve in line.curves:
        axes.axvspan(
            curve.start_m / M_PER_KM, curve.end_m / M_PER_KM, ymax=0.06, color=CURVE, lw=0.0
        )
    axes.set_ylim(low_m - room_m, high_m + room_m)
    axes.set_ylabel("height, m")
    axes.set_xlabel("chainage, km; curves are marked below")
    axes.set_xlim(line.start_m / M_PER_KM, line.end_m / M_PER_KM)
