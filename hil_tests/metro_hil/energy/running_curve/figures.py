"""The page of figures: figures 4 to 7 and 10 of [Ninh] for this hop and this train."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from firmware_py.storage.whole_file import whole_file
from metro_hil.energy.running_curve.design import Design, RunningCurve
from metro_hil.energy.running_curve.net import Net
from metro_hil.energy.running_curve.optimum import Optimum
from metro_hil.energy.running_curve.trace import CurveTrace
from metro_hil.energy.running_curve.train import RunningTrain

J_PER_MJ: Final = 1.0e6
KW: Final = 1.0e3
INK, QUIET = "#1f2933", "#7b8794"
DESIGNED, ECONOMICAL, CONVENTIONAL, BEST = "#0b62c4", "#2f9e44", "#c0242b", "#d98a00"
WINDOW_S: Final = 8.0
"""Width of the shown running times around the chosen one."""


@dataclass(frozen=True, slots=True)
class Sweep:
    """Results over the weight factor."""

    weight_factor: tuple[float, ...]
    accelerations_j: tuple[float, ...]
    powers_w: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class Page:
    """Everything that is drawn."""

    title: str
    train: RunningTrain
    use_ratio: float
    net: Net
    designed: Design
    conventional: RunningCurve
    """Curve <I>: greatest weight."""
    economical: RunningCurve
    """Curve <II>: no weight."""
    traces: Sequence[tuple[str, str, CurveTrace]]
    """Name, colour and run."""
    sweep: Sweep
    optimum: Optimum | None = None


def draw(path: Path, page: Page) -> None:
    """Draw the page and write it as a PNG."""
    with mpl.rc_context({"font.size": 9, "axes.edgecolor": QUIET, "text.color": INK}):
        figure = Figure(figsize=(14.0, 14.0), dpi=100, layout="constrained")
        FigureCanvasAgg(figure)
        figure.suptitle(page.title)
        axes = figure.subplot_mosaic([["net", "run"], ["parts", "choice"], ["weights", "weights"]])
        _net(axes["net"], page)
        _run(axes["run"], page)
        _parts(axes["parts"], page)
        _choice(axes["choice"], page)
        _weights(axes["weights"], page)
        with whole_file(path) as part:
            figure.savefig(part)


def _net(axes: Axes, page: Page) -> None:
    net, time_s = page.net, page.designed.time_s
    total_mj = net.total_j(page.use_ratio) / J_PER_MJ
    shown = np.where(np.abs(net.time_s - time_s) <= WINDOW_S, net.time_s, np.nan)
    for row in range(0, len(net.notch_off_mps), 4):
        axes.plot(shown[row], total_mj[row], color=QUIET, linewidth=0.5)
    for column in range(0, len(net.power_w), 6):
        axes.plot(shown[:, column], total_mj[:, column], color="#a9c7e8", linewidth=0.5)
    axes.axvline(time_s, color=INK, linewidth=0.8, linestyle=":")
    for name, colour, curve in (
        ("<I>", CONVENTIONAL, page.conventional),
        ("<II>", ECONOMICAL, page.economical),
        ("designed", DESIGNED, page.designed.curve),
    ):
        total = curve.total_j(page.use_ratio) / J_PER_MJ
        axes.plot([curve.time_s], [total], "o", color=colour, label=f"{name}: {total:.2f} MJ")
    if page.optimum is not None:
        cost = page.optimum.cost_j / J_PER_MJ
        axes.plot([page.optimum.time_s], [cost], "*", color=BEST, label=f"optimum: {cost:.2f} MJ")
    axes.set_xlabel("running time in s")
    axes.set_ylabel(f"energy, {page.use_ratio:.0%} of regeneration used, in MJ")
    axes.set_title("net of running time and energy (figure 4)", fontsize=9)
    axes.legend(fontsize=8)


def _run(axes: Axes, page: Page) -> None:
    power, time = axes.twinx(), axes.twinx()
    time.spines["right"].set_position(("axes", 1.17))
    for name, colour, run in page.traces:
        axes.plot(run.at_m, run.speed_mps, color=colour, label=name)
        power.plot(run.at_m, run.power_w / KW, color=colour, linewidth=0.7, linestyle="--")
        time.plot(run.at_m, run.time_s, color=colour, linewidth=0.7, linestyle=":")
    if page.optimum is not None:
        axes.plot(page.optimum.at_m, page.optimum.speed_mps, color=BEST, label="optimum")
    axes.set_xlabel("way in m")
    axes.set_ylabel("speed in m/s (solid)")
    power.set_ylabel("power at the wheel in kW (dashed)")
    time.set_ylabel("time in s (dotted)")
    axes.set_title("runs over the way (figure 5)", fontsize=9)
    axes.legend(fontsize=8, loc="lower center")


def _parts(axes: Axes, page: Page) -> None:
    """Draw acceleration and regenerated energy by themselves, and totals by the used share."""
    net, time_s = page.net, page.designed.time_s
    times_s = net.time_s[:, -1]
    shown = np.flatnonzero(np.abs(times_s - time_s) <= WINDOW_S)
    shown = shown[np.argsort(times_s[shown], kind="stable")]
    gained_mj = net.acceleration_j[shown, -1] / J_PER_MJ
    returned_mj = net.regenerated_j[shown, -1] / J_PER_MJ
    axes.plot(times_s[shown], gained_mj, color=CONVENTIONAL, label="E_acc")
    axes.plot(times_s[shown], returned_mj, color=ECONOMICAL, label="E_reg")
    for share, style in ((1.0, "-"), (0.7, "--"), (0.5, ":")):
        total_mj = gained_mj - share * returned_mj
        axes.plot(times_s[shown], total_mj, style, color=DESIGNED, label=f"total, {share:.0%} used")
    axes.axvline(time_s, color=INK, linewidth=0.8, linestyle=":")
    axes.set_xlabel("running time in s")
    axes.set_ylabel("energy of runs with the full brake, in MJ")
    axes.set_title("acceleration and regenerated energy (figure 6)", fontsize=9)
    axes.legend(fontsize=8)


def _choice(axes: Axes, page: Page) -> None:
    choice = page.designed.choice
    energies_mj = choice.accelerations_j / J_PER_MJ
    axes.plot(choice.times_s, energies_mj, ".", color=INK, markersize=3, label="runs, full brake")
    fine_s = np.linspace(choice.times_s.min(), choice.times_s.max(), 200)
    cubic_mj = np.polyval(choice.cubic_j, fine_s - choice.fastest_s) / J_PER_MJ
    axes.plot(fine_s, cubic_mj, color=QUIET, label="third-order E_acc(x)")
    axes.set_xlabel("x in s")
    axes.set_ylabel("acceleration energy in MJ")
    score = axes.twinx()
    score.plot(choice.times_s, choice.scores_ratio, color=DESIGNED)
    score.plot([choice.x_s], [choice.scores_ratio.min()], "o", color=DESIGNED)
    score.set_ylabel("f(x)", color=DESIGNED)
    title = f"weight {choice.weight_factor:g}: x = {choice.x_s:.2f} s (figure 7)"
    axes.set_title(title, fontsize=9)
    axes.legend(fontsize=8)


def _weights(axes: Axes, page: Page) -> None:
    sweep = page.sweep
    weights = np.asarray(sweep.weight_factor)
    axes.plot(weights, np.asarray(sweep.accelerations_j) / J_PER_MJ, color=CONVENTIONAL)
    axes.set_xlabel("weight factor")
    axes.set_ylabel("acceleration energy in MJ", color=CONVENTIONAL)
    power = axes.twinx()
    per_motor_kw = np.asarray(sweep.powers_w) / page.train.motors / KW
    power.plot(weights, per_motor_kw, color=DESIGNED)
    power.set_ylabel("power limit in kW a motor", color=DESIGNED)
    axes.axvline(page.designed.choice.weight_factor, color=INK, linewidth=0.8, linestyle=":")
    axes.set_title("energy and braking power over the weight (figure 10)", fontsize=9)
