"""The claims of "where the walls can move" in docs/design/architecture.md."""

import importlib
import inspect
import re
import typing
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from can_dbc.binding import kinds, sender
from can_dbc.diagnostics import EMERGENCIES
from can_dbc.nodes import Node
from canlog.command import VERBS as CANLOG_VERBS
from canlog.formats.registry import FORMATS
from firmware_py.buses import BusKind, parse_spec
from firmware_py.trackdb import load_line
from metro_hil.cli.hil import VERBS as HIL_VERBS
from metro_hil.model.run_options import parse
from metro_hil.monitors import invariants
from metro_hil.monitors.catalogue import WATCHED
from plant_emulator.consist import MODELS
from plant_emulator.train_config import ConsistModel
from plant_emulator.wire import PHASES_MS
from vobc.ato.laws import STRATEGIES, make_strategy
from vobc.ato.laws.predictive import Predictive
from vobc.ato.output import MAKERS, make_stage
from vobc.ato.settings.output import STAGES
from vobc.config import load_config
from vobc.vocabulary import cycle_input
from vobc.wire.frames import SENT_KINDS
from vobc.wire.inbox import RECEIVED_KINDS

ROOT = Path(__file__).parents[2]
ATO = load_config("florence4").ato


def modules_of(package: str) -> set[str]:
    """Names of the modules of a package, without those that begin with an underscore."""
    folder = Path(str(importlib.import_module(package).__file__)).parent
    return {path.stem for path in folder.glob("*.py") if not path.stem.startswith("_")}


def test_the_controller_can_send_every_frame_of_its_node() -> None:
    assert set(SENT_KINDS) == {kind for kind in kinds() if sender(kind) == Node.VOBC.name}


def test_the_train_sends_every_frame_of_the_other_nodes() -> None:
    on_occasion = {EMERGENCIES[node] for node in Node if node is not Node.VOBC}

    assert set(PHASES_MS) | on_occasion == {
        kind for kind in kinds() if sender(kind) != Node.VOBC.name
    }


def test_the_inbox_takes_the_frames_that_the_controller_acts_on() -> None:
    hints = typing.get_type_hints(cycle_input)
    received = {typing.get_args(each)[0] for each in hints.values() if typing.get_args(each)}
    frames = {typing.get_args(each)[0] for each in received if "Received[" in str(each)}

    assert frames & set(kinds()) == set(RECEIVED_KINDS)


def test_a_law_is_a_line_in_a_table(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(typing.cast(dict[str, Any], STRATEGIES), "mine", Predictive)

    assert parse(["run", "--ato", "mine"]).ato == "mine"
    law = make_strategy(replace(ATO, strategy="mine"), load_line("florence"), 0.05)
    assert isinstance(law, Predictive)


def test_every_law_has_its_page_and_no_other_page_is_there() -> None:
    pages = {path.stem for path in (ROOT / "docs" / "reference" / "laws").glob("*.toml")}

    assert pages == set(STRATEGIES)


def test_every_output_stage_can_be_made() -> None:
    assert set(MAKERS) == set(STAGES)
    made = {type(make_stage(replace(ATO.output, stage=stage))) for stage in STAGES}
    assert len(made) == len(STAGES)


@pytest.mark.parametrize("kind", BusKind)
def test_every_bus_can_be_named(kind: BusKind) -> None:
    assert parse_spec(f"{kind.value}:x").kind is kind


def test_every_consist_model_is_in_the_table() -> None:
    assert set(MODELS) == set(ConsistModel)


def test_every_watched_invariant_is_wired_to_a_watch() -> None:
    wired = re.findall(r'gauge\["([a-z0-9-]+)"\]', inspect.getsource(invariants))

    assert sorted(set(wired)) == sorted(each.name for each in WATCHED)


def test_a_verb_of_hil_is_a_module_and_its_name_in_the_list() -> None:
    found = {
        name
        for name in modules_of("metro_hil.cli.hil")
        if hasattr(importlib.import_module(f"metro_hil.cli.hil.{name}"), "add")
    }

    assert found == {verb.replace("-", "_") for verb in HIL_VERBS}


def test_a_verb_of_canlog_is_a_module_and_its_line_in_the_table() -> None:
    found = {
        name
        for name in modules_of("canlog.verbs")
        if hasattr(importlib.import_module(f"canlog.verbs.{name}"), "run")
    }

    assert found == set(CANLOG_VERBS)
    for name in CANLOG_VERBS:
        assert callable(importlib.import_module(f"canlog.verbs.{name}").options)


def test_a_log_format_is_a_module_and_its_line_in_the_table() -> None:
    readers = {
        name
        for name in modules_of("canlog.formats")
        if hasattr(importlib.import_module(f"canlog.formats.{name}"), "read")
    }

    assert readers == {each.module for each in FORMATS}
    assert all(callable(each.write) for each in FORMATS if each.writes)
