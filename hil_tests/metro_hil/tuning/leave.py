"""Writes the tuned parameters as a complete parameter file that records its origin."""

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import tomli_w

from firmware_py.settings import find, parse
from firmware_py.storage.whole_file import write_whole
from metro_hil.model.run_folder import plain
from metro_hil.tuning.objective import CM_PER_M, RunFigures
from metro_hil.tuning.training import Ground
from metro_hil.tuning.tuner import Tuned
from vobc.config import SHIPPED, load_config


def parameter_file(ground: Ground, tuned: Tuned, head: Mapping[str, object]) -> str:
    """The parameter file of the start, with the chosen law and the tuned settings.

    A table with a tuned setting is written in full, so that a person can read and edit it.

    Args:
        head: further origins for the comment at the top.
    """
    changes = {"ato.strategy": ground.law, **tuned.after}
    config = load_config(ground.params, changes=changes)
    document: dict[str, Any] = parse(find(ground.params, SHIPPED))
    ato = document.setdefault("ato", {})
    ato["strategy"] = ground.law
    for name in sorted({key.split(".")[1] for key in tuned.after}):
        ato[name] = plain(getattr(config.ato, name))
    lines = [*_comment(ground, tuned, head), "", tomli_w.dumps(document)]
    return "\n".join(lines)


def write_parameters(path: Path, text: str) -> None:
    """Write the file. Raises OSError."""
    path.parent.mkdir(parents=True, exist_ok=True)
    write_whole(path, text)


def _comment(ground: Ground, tuned: Tuned, head: Mapping[str, object]) -> list[str]:
    costs = f"{tuned.cost_before_m * CM_PER_M:.3f} cm, then {tuned.cost_after_m * CM_PER_M:.3f} cm"
    said = {
        "law": ground.law,
        "line": ground.line,
        "consist": ground.consist,
        "parameters": ground.params,
        **head,
        "runs": f"{tuned.runs} of training, {tuned.points} sets of settings",
        "cost in training": costs,
    }
    lines = ["# Made by `vobc tune`."]
    lines += [f"# {name}: {value}" for name, value in said.items()]
    for when, figures in (("before", tuned.figures_before), ("after", tuned.figures_after)):
        if figures is not None:
            lines.append(f"# other seeds, {when}: {_words(figures)}")
    lines += [
        f"# {key}: {tuned.before[key]:g} -> {tuned.after[key]:g}" for key in sorted(tuned.after)
    ]
    return lines


def _words(figures: RunFigures) -> str:
    mean_m, worst_m = figures.error_mean_m, figures.error_worst_m
    if mean_m is None or worst_m is None:
        return f"no stop made in {figures.runs} runs"
    return (
        f"mean {mean_m * CM_PER_M:.2f} cm, worst {worst_m * CM_PER_M:.2f} cm of {figures.runs} "
        f"runs, {figures.stops_missed} missed"
    )


def as_document(tuned: Tuned) -> dict[str, Any]:
    """The result as a table for `--json`."""
    return {name: plain_figures(getattr(tuned, name)) for name in tuned.__struct_fields__}


def plain_figures(value: object) -> object:
    if isinstance(value, RunFigures):
        return {name: getattr(value, name) for name in value.__struct_fields__}
    assert not dataclasses.is_dataclass(value)
    return value
