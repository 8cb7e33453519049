"""Axes of figures about several trains on one supply network."""

from collections.abc import Iterable, Sequence
from typing import Final

import numpy as np
from matplotlib.axes import Axes

from plant_emulator.power.supplies import Supply

INK, QUIET, USED, BURNT = "#1f2933", "#7b8794", "#2f9e44", "#c0242b"
W_PER_KW: Final = 1000.0
Series = tuple[Sequence[float], Sequence[float]]
"""Instants in s, and values."""


def draw_voltages(axes: Axes, supply: Supply, volts: Iterable[Series]) -> None:
    """Draw the voltage of each train, in the order of their numbers."""
    for index, (at_s, train_v) in enumerate(volts):
        axes.plot(at_s, train_v, linewidth=0.6, color=f"C{index}")
    axes.axhline(supply.no_load_v, color=INK, linewidth=0.8, linestyle="--")
    axes.axhline(supply.voltages.chops_from_v, color=BURNT, linewidth=0.8, linestyle=":")
    axes.set_ylabel("voltage at pantographs in V")
    axes.set_title(
        "dashed: no load; dotted: braking resistors begin", fontsize=7, loc="right", color=QUIET
    )


def draw_substations(
    axes: Axes, supply: Supply, at_s: Sequence[float], powers_w: Sequence[Sequence[float]]
) -> None:
    """Draw the power of each substation.

    Args:
        powers_w: by instant, of all substations.
    """
    labels = [station.joint for station in supply.substations]
    given_kw = np.array(powers_w).reshape(-1, len(labels)) / W_PER_KW
    if float(np.min(given_kw, initial=0.0)) >= 0.0:
        axes.stackplot(at_s, given_kw.T, labels=labels)
    else:
        # An inverter returns power, and a stack has no negative parts.
        for label, power_kw in zip(labels, given_kw.T, strict=True):
            axes.plot(at_s, power_kw, linewidth=0.8, label=label)
    axes.set_ylabel("substations in kW")
    axes.set_xlabel("time in s")
    axes.margins(y=0.15)
    axes.legend(fontsize=7, loc="upper right", ncols=5)
