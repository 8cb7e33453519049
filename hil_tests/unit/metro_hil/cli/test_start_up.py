"""Help starts at once: it imports neither train nor controller, and its names are the real ones."""

import argparse
import os
import subprocess
import sys

import pytest

from can_dbc.cab import CabMode
from firmware_py.radio import zenoh_radio
from metro_hil.cli import hil
from metro_hil.model import known_names
from plant_emulator.cli import names
from plant_emulator.desk.drivers import DRIVERS
from vobc.ato.laws import STRATEGIES
from vobc.ato.settings.output import STAGES
from zenoh_config import sessions, t2t, timers

MODULES_MAX = 190
"""A bare Python has about 60 modules and argparse 30; numpy alone would add 90."""
WORKER_MODULES_MAX = 680
RUN_MODULES_MAX = 800
ENTRIES = {"canlog": "canlog.entry", "plant": "plant_emulator.entry"}
"""Modules of the console scripts that are not in `metro_hil`."""
COUNT = """
import sys
sys.argv = {words!r}
from {entry} import {program}
try:
    {program}()
finally:
    heavy = {{"numpy", "can_dbc", "vobc", "plant_emulator", "canlog", "cantools", "matplotlib"}}
    heavy -= {{{package!r}}}
    print(len(sys.modules), sorted(heavy & set(sys.modules)), file=sys.stderr)
"""
UNUSED = {
    *("cantools", "matplotlib", "scipy", "pandas", "rich", "canlog", "email", "asyncio", "zenoh"),
    *("can", "can_dbc.dbc_parser", "vobc.train_to_train", "vobc.process.line_command"),
}
"""Packages that a case does not use."""
REPORTS = """
from metro_hil.report.campaign import CampaignInfo
from metro_hil.report.campaign.ledger import join
from metro_hil.report.campaign.parquet import measures_table
from metro_hil.report.estimates import pass_share
pass_share(3, 4)
measures_table(CampaignInfo(name="none", expected_cases=0), join([], [], expected_cases=0))
"""
IMPORTS = """
import sys
{imports}
print(len(sys.modules), sorted({unused!r} & set(sys.modules)))
"""


@pytest.mark.parametrize(
    "words",
    [
        ("vobc", "--help"),
        ("vobc", "--version"),
        ("vobc", "run", "--help"),
        ("vobc", "run", "--lockstep", "--no-such-option"),
        ("hil", "--help"),
        ("hil", "--version"),
        ("canlog", "--help"),
        ("canlog", "--version"),
        ("canlog", "no-such-verb"),
        ("plant", "--help"),
        ("plant", "run", "--help"),
    ],
)
def test_help_imports_few_modules(words: tuple[str, ...]) -> None:
    """The test counts modules, which are the same on any machine, and not time."""
    entry = ENTRIES.get(words[0], "metro_hil.cli.entry")
    package = entry.partition(".")[0]
    program = COUNT.format(words=list(words), program=words[0], entry=entry, package=package)
    done = subprocess.run(
        [sys.executable, "-c", program],
        # With a compiled copy the program would begin again there, without the count.
        env={**os.environ, "VOBC_NATIVE": "wire"},
        capture_output=True,
        text=True,
        check=False,
    )

    count, _, heavy = done.stderr.splitlines()[-1].partition(" ")
    assert int(count) < MODULES_MAX, done.stderr
    assert heavy == "[]"


@pytest.mark.parametrize(
    ("modules", "unused", "modules_max"),
    [
        (("metro_hil.engine.worker", "metro_hil.run.dispatch"), UNUSED, WORKER_MODULES_MAX),
        (("metro_hil.cli.vobc_run",), UNUSED - {"rich", "canlog"}, RUN_MODULES_MAX),
    ],
)
def test_a_worker_and_a_run_import_only_what_they_use(
    modules: tuple[str, ...], unused: set[str], modules_max: int
) -> None:
    count, found = modules_after("\n".join(f"import {name}" for name in modules), unused)

    assert found == "[]"
    assert count < modules_max


def test_the_reports_of_a_campaign_load_neither_pandas_nor_all_of_the_statistics() -> None:
    _, found = modules_after(REPORTS, {"pandas", "scipy.stats"})

    assert found == "[]"


def modules_after(statements: str, unused: set[str]) -> tuple[int, str]:
    """Number of modules after these statements in a bare Python, and the unused ones among them."""
    program = IMPORTS.format(imports=statements, unused=unused)
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True
    )
    count, _, found = done.stdout.strip().partition(" ")
    return int(count), found


def test_the_names_of_the_command_line_are_the_real_ones() -> None:
    assert list(known_names.LAWS) == sorted(STRATEGIES)
    assert known_names.STAGES == STAGES
    assert list(known_names.DRIVERS) == list(DRIVERS)
    assert list(known_names.TIMERS) == sorted(timers.TIMER_SETS)
    assert (known_names.DESK, known_names.FAULTS) == names.BY_HAND
    assert known_names.LAST_TRAIN == t2t.LAST_TRAIN
    assert known_names.LINE_ENDPOINT == sessions.LINE_ENDPOINT


def test_the_names_of_the_plant_are_the_real_ones() -> None:
    assert tuple(mode.name.lower() for mode in CabMode) == names.MODES
    assert tuple(DRIVERS) == names.DRIVERS
    assert tuple(sorted(timers.TIMER_SETS)) == names.TIMERS
    assert names.LAST_TRAIN == t2t.LAST_TRAIN
    assert names.LINE_ENDPOINT == sessions.LINE_ENDPOINT
    assert names.WAYSIDE_ENDPOINT == zenoh_radio.DEFAULT_ENDPOINT


def test_the_help_texts_of_hil_are_those_of_its_verbs() -> None:
    (verbs,) = (
        action for action in hil.parser()._actions if isinstance(action, argparse._SubParsersAction)
    )

    assert {each.dest: each.help for each in verbs._choices_actions} == hil.VERBS
