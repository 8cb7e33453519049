"""Campaign files: valid ones become cases, and errors are reported with file, key and value."""

import re
import shutil
import tomllib
from importlib import resources
from pathlib import Path
from typing import Any, Final

import pytest
import tomli_w
from hypothesis import given
from hypothesis import strategies as st

from firmware_py.settings import SettingsError, shipped_names
from metro_hil.campaign import (
    Campaign,
    CampaignError,
    define,
    plan_cases,
    read_campaign,
    read_definition,
)
from metro_hil.campaign.builder import Scenario
from metro_hil.campaign.tables import merged
from metro_hil.model.case import BenchKind, Branch, ControllerSpec, ExpectedFailure, Setup
from metro_hil.model.case_setup import parts_of

FULL: Final = """
title = "Runaway traction is stopped"
requirements = ["ACC-05", "INV-03"]
seeds = 2
seed_base = 7
expected = { fails = "inv-04-civil-limit", margin_min = -2.0 }
stop_at_violation = false
[train]
start = "I"
load_ratio = 0.5
cycle_ms = 100
[train.real]
"brake.service.gain_ratio" = 0.9
[train.believed]
atp.warning_margin_mps = 0.5
[timetable]
stops = ["II", "IV"]
dwell_s = { II = 12.5 }
[[fault]]
kind = "traction_runaway"
when = "speed_mps > 16.6"
accel_mps2 = 1.0
[sweep]
[sweep.factors]
"fault.0.start_s" = [10.0, 20.0]
"""


def campaign_of(text: str) -> Campaign:
    return define(tomllib.loads(text), source="x.toml", name="x").campaign


def problems_of(text: str) -> tuple[str, ...]:
    with pytest.raises(CampaignError) as caught:
        campaign_of(text)
    return caught.value.problems


def believed_key() -> str:
    """The dotted key of a number in the shipped parameters."""
    path = resources.files("vobc.params") / "florence4.toml"
    table: dict[str, object] = tomllib.loads(path.read_text(encoding="utf-8"))["atp"]
    return "atp." + next(name for name, value in table.items() if isinstance(value, float))


def test_all_settings_of_a_file_are_in_its_cases() -> None:
    text = FULL.replace("atp.warning_margin_mps = 0.5", f"{believed_key()} = 0.5")

    cases = plan_cases(campaign_of(text))

    assert [case.id for case in cases] == ["x/0000-s7", "x/0000-s8", "x/0001-s7", "x/0001-s8"]
    assert [case.index for case in cases] == [0, 1, 2, 3]
    last = cases[-1]
    assert last.scenario == "x"
    assert last.seed == 8
    assert last.setup == Setup(
        start="I",
        end="IV",
        load_ratio=0.5,
        cycle_ms=100.0,
        real={"brake.service.gain_ratio": 0.9},
        believed={believed_key(): 0.5},
        stops=("II", "IV"),
        dwell_s={"II": 12.5},
    )
    assert last.faults == (
        {
            "kind": "traction_runaway",
            "when": "speed_mps > 16.6",
            "accel_mps2": 1.0,
            "start_s": 20.0,
        },
    )
    assert last.factors == {"fault.0.start_s": 20.0}
    assert last.requirements == ("ACC-05", "INV-03")
    assert last.expected == (ExpectedFailure(monitor="inv-04-civil-limit", margin_min=-2.0),)
    assert not last.stop_at_violation
    assert last.bench is BenchKind.LOCKSTEP
    assert last.controller == ControllerSpec()
    assert last.branch is None
    assert last.invariants == "all"


def test_an_empty_file_is_one_run_of_the_whole_line() -> None:
    (case,) = plan_cases(campaign_of(""))

    assert case.id == "x/s1"
    assert case.setup == Setup()


def test_controller_and_branch_are_read() -> None:
    (case,) = plan_cases(
        campaign_of(
            'bench = "processes"\ninvariants = "none"\n'
            'controller = { kind = "command", command = "other --bus {bus}" }\n'
            'branch = { seed = 3, when = "front_m > 900" }'
        )
    )

    assert case.bench is BenchKind.PROCESSES
    assert case.invariants == "none"
    assert case.controller == ControllerSpec(kind="command", command="other --bus {bus}")
    assert case.branch == Branch(seed=3, when="front_m > 900")


FACTOR: Final = 'factors = { "train.load_ratio" = [0.0, 1.0] }'
WRONG: Final = [
    ('nam = "a"', "nam: unknown key; nearest valid key: name"),
    ("name = 3", "name: 3 is not a string"),
    ('name = "a/b"', "name: 'a/b' is no name for a folder"),
    ("layout = 3", "layout: 3 is not a string"),
    ('requirements = ["ACC5"]', "requirements: 'ACC5' is no id such as INV-04"),
    ('bench = "lockstp"', "bench: 'lockstp': nearest valid value: lockstep"),
    ('expected = "fail"', "expected: 'fail' names no monitor; write expected = { fails ="),
    ("expected = 3", "expected: 3 is neither a table nor a list of them; write expected ="),
    ("expected = { fails = 3 }", "expected.fails: 3 is no name"),
    ("expected = { margin_min = -1 }", "expected.fails: missing key"),
    ('expected = { fails = "m" }', "expected.fails: 'm' is no monitor of this scenario; valid"),
    (
        'expected = { fails = "inv-04-civil-limit", fail = "m" }',
        "expected.fail: unknown key; nearest valid key: fails",
    ),
    ('expected = { fails = "inv-04-civil-limit", margin_max = 0.1 }', "margin_max: 0.1 is no fail"),
    (
        'expected = [{ fails = "inv-04-civil-limit", margin_min = -1, margin_max = -2.0 }]',
        "expected[0].margin_min: -1 is over margin_max, -2",
    ),
    ('vacuous = "allowed"', "vacuous: 'allowed' says neither what nor why; write vacuous = {"),
    ('vacuous = { allowed = "case" }', "vacuous.reason: None is no reason"),
    (
        'vacuous = { allowed = "brakes", reason = "x" }',
        "vacuous.allowed: 'brakes' is no monitor, fault, requirement or group of this scenario",
    ),
    (
        'monitor = [{ stl = "always(1 <= 2)" }]',
        "monitor[0].stl: 'always(1 <= 2)' at character 10: compares without a signal",
    ),
    (
        'monitor = [{ stl = "always(speed_mps <= speed_mps)" }]',
        "is true for all values of its signals; no run can violate it",
    ),
    (
        'monitor = [{ measure = "emergency_count", min = 0 }]',
        "monitor[0].min: 0: emergency_count is never less than 0, so no run can violate it",
    ),
    ("stop_at_violation = 1", "stop_at_violation: 1 is not true or false"),
    ("seeds = 0", "seeds: 0 is not within 1..10000000"),
    ("seeds = [1, 1]", "seeds: 1 is listed twice"),
    ("seeds = [1, -2]", "seeds: -2 is not a whole number of 0 or more"),
    ("seeds = 1.5", "seeds: 1.5 is neither a whole number nor a list of them"),
    ("seeds = true", "seeds: True is neither a whole number nor a list of them"),
    ("seed_base = -1", "seed_base: -1 is not within 0.."),
    ('invariants = "al"', "invariants: 'al' is neither 'all', 'none' nor a list of names"),
    ("train = 3", "train: 3 is not a table"),
    ("fault = { kind = 'tacho_stuck' }", "is not an array of tables; write [[fault]]"),
    ("[train]\nlod_ratio = 1", "train.lod_ratio: unknown key; nearest valid key: load_ratio"),
    ("[train]\nload_ratio = 1.5", "train.load_ratio: 1.5 is not within 0..1"),
    ("[train]\nload_ratio = nan", "train.load_ratio: nan is not a finite number"),
    ("[[fault]]\nkind = 'tacho_stuck'\nstart_s = inf", "fault[0].start_s: inf is not a finite"),
    ("name = ''", "name: '' is no name for a folder"),
    ('title = "a\\nb"', "title: 'a\\nb' is more than one line"),
    ('title = "\\u001b[31mred"', "title: '\\x1b[31mred' holds control characters"),
    ("[train]\nload_ratio = 1979-05-27", "is neither number, text nor true or false"),
    ("[train]\nodometer_error = 0.3", "train.odometer_error: 0.3 is not within -0.2..0.2"),
    ("[train]\ncycle_ms = 4", "train.cycle_ms: 4.0 is not within 5..200"),
    ("[train]\nduration_s = 0", "train.duration_s: 0.0 is not within 0.1..86400"),
    ('[train]\ndesk_mode = "aut"', "train.desk_mode: 'aut': nearest valid value: auto"),
    ('[train]\nstops = ["I"]', "train.stops: unknown key"),
    ('[train]\nline = "florenz"', "train.line: florenz: nearest valid shipped name: florence"),
    ('[train]\nconsist = "florence5"', "train.consist: florence5: nearest valid shipped name"),
    ('[train]\nparams = "florence5"', "train.params: florence5: nearest valid shipped name"),
    ('[train]\nparams = "no/such.toml"', "no/such.toml: no such file"),
    ('[train]\nend = "V"', "train.end: 'V' is no station of line florence; nearest valid"),
    ('[train]\nstart = "III"\nend = "II"', "train.end: 'II' lies at 3000 m, not beyond III"),
    ('[train.real]\n"brake.servce.x" = 1', "train.real: brake.servce: unknown key; nearest"),
    ('[train.real]\n"brake.service.max_decel_mps2" = "a"', "max_decel_mps2: 'a' is not a number"),
    ('[train.real]\n"load_ratio" = 3', "train.real"),
    ('[train.believed]\n"atpp" = 1', "train.believed: atpp: unknown key; nearest valid key: atp"),
    ("[train]\nreal = 3", "train.real: 3 is not a table"),
    ('[timetable]\nstops = ["Q"]', "timetable.stops: 'Q' is no station of line florence"),
    ('[timetable]\nstops = ["III", "II"]', "timetable.stops: 'III' at 3500 m does not lie"),
    ("[timetable]\nstops = []", "timetable.stops: [] names no station"),
    ("[timetable]\ndwell_s = { Q = 1 }", "timetable.dwell_s: 'Q' is no station"),
    ("[timetable]\ndwell_s = { I = -1 }", "timetable.dwell_s: I = -1 is not within 0..3600"),
    ('[train]\nend = "IV"\n[timetable]\nstops = ["II"]', "the last stop must be 'IV'"),
    ('[controller]\nkind = "checkout"', "controller.kind: 'checkout' needs path"),
    ('[controller]\npath = "x"', "controller.path: 'x' belongs to kind 'checkout'"),
    ('[controller]\nkynd = "x"', "controller.kynd: unknown key; nearest valid key: kind"),
    ('[branch]\nwhen = "speed_mps > 1"', "branch.seed: missing key"),
    ('[branch]\nseed = 1\nwhen = "sped > 1"', "branch.when: 'sped > 1': unknown signal sped"),
    ("[[fault]]\nstart_s = 3", "fault[0].kind: missing key"),
    (
        '[[fault]]\nkind = "brake_lat"',
        "fault[0].kind: 'brake_lat': unknown kind; nearest valid kind: brake_late",
    ),
    ('[[fault]]\nkind = "tacho_stuck"\naxl = "a"', "fault[0].axl: unknown key; nearest valid"),
    ('[[fault]]\nkind = "tacho_stuck"\naxle = "c"', "fault[0].axle: 'c'"),
    ('[[fault]]\nkind = "brake_weak"\ngain_ratio = 9', "fault[0].gain_ratio: 9 is not within"),
    ('[[fault]]\nkind = "brake_weak"\nend_s = -1', "fault[0].end_s: -1 is not after start_s 0"),
    ('[[fault]]\nkind = "brake_weak"\nwhen = "sped > 1"', "fault[0].when: 'sped > 1': unknown"),
    (
        '[[monitor]]\nname = "a"\nstl = "always(sped < 1)"',
        "monitor[0].stl: 'always(sped < 1)' at character 8: unknown signal sped; nearest: speed",
    ),
    (
        '[[monitor]]\nname = "a"\nmeasure = "stop_error_wrst_m"\nmax = 1.0',
        "monitor[0].measure: 'stop_error_wrst_m': nearest",
    ),
    ('invariants = ["INV-99"]', "invariants: 'INV-99': "),
    (f"[sweep]\ncount = 3\n{FACTOR}", "sweep.count: 3 is for lhs, sobol and random alone"),
    (f'[sweep]\ndesin = "lhs"\n{FACTOR}', "sweep.desin: unknown key; nearest valid key: design"),
    (f'[sweep]\ndesign = "lsh"\n{FACTOR}', "sweep.design: 'lsh': nearest valid value: lhs"),
    (f'[sweep]\ndesign = "lhs"\n{FACTOR}', "sweep.design: 'lhs' needs count"),
    (f"[sweep]\nstrength = 2\n{FACTOR}", "sweep.strength: 2 is for design covering alone"),
    ('[sweep]\ndesign = "pairwise"', "sweep.factors: missing key"),
    ("[sweep]\nfactors = 3", "sweep.factors: 3 is not a table"),
]


@pytest.mark.parametrize(("text", "said"), WRONG, ids=[said[:40] for _, said in WRONG])
def test_every_error_is_reported_with_file_key_and_value(text: str, said: str) -> None:
    problems = problems_of(text)

    assert any(said in problem for problem in problems), problems
    assert len(problems) == 1, problems
    assert problems[0].startswith("x.toml: ")
    assert "\n" not in problems[0]


WRONG_FACTORS: Final = [
    ('"train.load_ratio" = 3', "3 is neither a list nor"),
    ('"train.load_ratio" = []', "[] has no level"),
    ('"train.load_ratio" = [0.1, 0.1]', "0.1 is listed twice"),
    ('"train.load_ratio" = [0.5, 1.5]', "1.5 is not within 0..1"),
    ('"train.load_ratio" = { low = 0, high = 2, count = 3 }', "2.0 is not within 0..1"),
    ('"train.load_ratio" = { low = 0.0, high = 1.0 }', "a range needs count or step"),
    ('"train.load_ratio" = { low = 1, high = 0, count = 2 }', "high: 0 is not above low 1"),
    ('"train.load_ratio" = { low = 0, high = 1, count = 1 }', "count: 1 is not within 2.."),
    ('"train.load_ratio" = { low = 0, high = 1, cout = 1 }', "cout: unknown key; nearest valid"),
    ('"train.load_ratio" = { low = 0, high = 1, step = 0 }', "step: 0 is not positive"),
    ('"train.load_ratio" = { low = 0, high = 1, step = 1, count = 2 }', "exclude each other"),
    ('"train.load_ratio" = { low = 0, high = 1, count = 2, scale = "log" }', "low: 0 is not posi"),
    ('"train.load_ratio" = { low = 0.5, high = 1, count = 2, integer = true }', "no whole number"),
    ('"train.lod_ratio" = [1]', "unknown key; nearest valid key: load_ratio"),
    ('"trian.load_ratio" = [1]', "cannot be swept; nearest valid beginning: train"),
    ('"seeds" = [1]', "cannot be swept"),
    ('"train" = [1]', "is a whole table"),
    ('"fault.1.start_s" = [1]', "no such fault; there is fault.0"),
    ('"fault.first.start_s" = [1]', "no such fault; there is fault.0"),
    ('"monitor.0.max" = [1]', "no such monitor; none"),
    ('"fault.0.delay" = [1.0]', "unknown key; nearest valid key: delay_s"),
    ('"fault.0.delay_s" = [1.0, 99.0]', "99 is not within 0..30"),
    ('"fault.0.kind" = ["brake_late", "brake_lte"]', "'brake_lte': unknown kind; nearest"),
    ('"fault.0.start_s" = { phase_of = "cycl", count = 4 }', "'cycl': nearest valid value: cycle"),
    ('"fault.0.start_s" = { phase_of = "cycle", count = 0 }', "count: 0 is not within 1.."),
    ('"train.end" = ["IV", "V"]', "'V' is no station of line florence"),
    ('"train.consist" = ["florence4", "florence5"]', "florence5: nearest valid shipped name"),
]


@pytest.mark.parametrize(("factor", "said"), WRONG_FACTORS, ids=[a for a, _ in WRONG_FACTORS])
def test_a_wrong_factor_is_named(factor: str, said: str) -> None:
    key = factor.partition(" = ")[0]
    text = f'[[fault]]\nkind = "brake_late"\n[sweep.factors]\n{factor}\n'

    problems = problems_of(text)

    assert len(problems) == 1, problems
    assert problems[0].startswith(f"x.toml: sweep.factors.{key}")
    assert said in problems[0]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ('exclude = ["lod_ratio > 1"]', "unknown signal lod_ratio; nearest: load_ratio"),
        ('exclude = ["load_ratio >"]', "not an expression"),
        ('exclude = ["load_ratio >= 0"]', "leaves no point"),
        ('exclude = ["1 / load_ratio > 3"]', "divides by zero with train.load_ratio = 0.0"),
    ],
)
def test_a_wrong_exclusion_is_named(text: str, said: str) -> None:
    problems = problems_of(f'[sweep]\n{text}\n[sweep.factors]\n"train.load_ratio" = [0.0, 1.0]\n')

    assert len(problems) == 1, problems
    assert problems[0].startswith("x.toml: sweep.exclude: ")
    assert said in problems[0]


def test_values_that_fail_only_in_combination_are_all_named() -> None:
    (problem,) = problems_of(
        '[sweep.factors]\n"train.start" = ["I", "III"]\n"train.end" = ["II", "IV"]\n'
    )

    assert "'II' lies at 3000 m, not beyond III" in problem


def test_all_errors_are_reported_at_once() -> None:
    problems = problems_of(
        'nam = "x"\nseeds = -3\n[train]\nend = "Z"\nlod_ratio = 1\nload_ratio = 1.5\n'
        '[timetable]\ndwell_s = { Q = 3 }\n[[fault]]\nkind = "brake_lat"\n'
        '[[fault]]\nkind = "brake_weak"\ngain = 1\ngain_ratio = 9\nwhen = "sped > 3"\n'
        '[sweep.factors]\n"fault.7.x" = [1]\n"train.x" = 3\n'
        '[[scenario]]\n[[scenario]]\nname = "b"\n[scenario.train]\ncycle_ms = 3\n'
        '[[scenario]]\nname = "b"\n[[scenario.fault]]\nkind = "x"\n'
    )

    keys = [problem.split(": ")[1] for problem in problems]
    assert set(keys) == {
        *("nam", "seeds", "train.lod_ratio", "train.load_ratio", "train.end", "timetable.dwell_s"),
        *("fault[0].kind", "fault[1].gain", "fault[1].gain_ratio", "fault[1].when"),
        *('sweep.factors."fault.7.x"', 'sweep.factors."train.x"'),
        *("scenario[0].name", "scenario[1].train.cycle_ms", "scenario[2].name"),
        "scenario[2].fault[0].kind",
    }


def test_a_scenario_inherits_what_it_does_not_set_itself() -> None:
    campaign = campaign_of(
        """
        requirements = ["ACC-01"]
        [train]
        end = "I"
        load_ratio = 0.5
        [train.real]
        "brake.service.gain_ratio" = { low = 0.9, high = 1.0 }
        [[fault]]
        kind = "tacho_stuck"
        [sweep.factors]
        "train.load_ratio" = [0.0, 1.0]
        [[scenario]]
        name = "a"
        [[scenario]]
        name = "b"
        expected = { fails = "inv-04-civil-limit" }
        requirements = ["ACC-02"]
        train = { end = "II", real = { brake = { service = { gain_ratio = 0.5 } } } }
        fault = [{ kind = "brake_late" }]
        sweep = {}
        """
    )

    a, b = plan_cases(campaign)[0], plan_cases(campaign)[-1]
    assert [case.id for case in plan_cases(campaign)] == ["a/0000-s1", "a/0001-s1", "b/s1"]
    assert (a.setup.end, b.setup.end) == ("I", "II")
    assert b.setup.load_ratio == 0.5
    assert b.setup.real == {"brake.service.gain_ratio": 0.5}
    assert [fault["kind"] for fault in b.faults] == ["tacho_stuck", "brake_late"]
    assert (a.expected, [each.monitor for each in b.expected]) == ((), ["inv-04-civil-limit"])
    assert (a.requirements, b.requirements) == (("ACC-01",), ("ACC-02",))


leaf = st.integers(0, 3)
tables: Final = st.recursive(
    st.fixed_dictionaries({}, optional={"p": leaf, "q": leaf}),
    lambda inner: st.fixed_dictionaries(
        {}, optional={"p": leaf, "q": leaf, "r": inner, "t": inner}
    ),
    max_leaves=6,
)


def leaves(table: Any, path: tuple[str, ...] = ()) -> dict[tuple[str, ...], int]:
    if not isinstance(table, dict):
        return {path: table}
    return {
        key: value
        for name, inner in table.items()
        for key, value in leaves(inner, (*path, name)).items()
    }


@given(tables, tables)
def test_inheritance_keeps_every_leaf_that_is_not_overridden(
    above: dict[str, Any], own: dict[str, Any]
) -> None:
    before = repr((above, own))

    made = merged(above, own)

    assert leaves(made) == leaves(above) | leaves(own)
    assert repr((above, own)) == before


def test_the_same_file_gives_the_same_ids_and_fingerprint_and_another_seed_another() -> None:
    text = FULL.replace("atp.warning_margin_mps = 0.5", f"{believed_key()} = 0.5")

    first, again = campaign_of(text), campaign_of(text)
    other = campaign_of(text.replace("seed_base = 7", "seed_base = 8"))

    assert plan_cases(first) == plan_cases(again)
    assert first.fingerprint == again.fingerprint
    assert re.fullmatch(r"[0-9a-f]{64}", first.fingerprint)
    assert other.fingerprint != first.fingerprint


def test_more_seeds_do_not_rename_the_cases_that_were_there() -> None:
    sweep = '[sweep.factors]\n"train.load_ratio" = [0.0, 1.0]\n'

    few = plan_cases(campaign_of(f"seeds = 2\n{sweep}"))
    many = plan_cases(campaign_of(f"seeds = 5\n{sweep}"))

    assert {case.id for case in few} < {case.id for case in many}


def test_ids_are_names_of_folders_and_differ() -> None:
    cases = plan_cases(
        campaign_of(
            'seeds = 3\n[sweep]\ndesign = "random"\ncount = 20\n'
            '[sweep.factors]\n"train.load_ratio" = { low = 0.0, high = 1.0 }\n'
            '[[scenario]]\nname = "one"\n[[scenario]]\nname = "two"\n'
        )
    )

    assert len({case.id for case in cases}) == len(cases) == 120
    assert [case.index for case in cases] == list(range(120))
    assert all(re.fullmatch(r"[a-z]+/[0-9]{4}-s[0-9]+", case.id) for case in cases)


def test_each_point_may_have_seeds_of_its_own() -> None:
    sweep = '[sweep]\nnew_seeds = true\n[sweep.factors]\n"train.load_ratio" = [0.0, 0.5, 1.0]\n'

    cases = plan_cases(campaign_of(f"seeds = 2\nseed_base = 10\n{sweep}"))

    assert [case.seed for case in cases] == [10, 11, 12, 13, 14, 15]
    assert "needs seeds as a number" in problems_of(f"seeds = [1, 5]\n{sweep}")[0]


def test_a_phase_sweep_follows_the_cycle_of_each_point() -> None:
    cases = plan_cases(
        campaign_of(
            '[[fault]]\nkind = "tacho_stuck"\n[sweep.factors]\n'
            '"fault.0.start_s" = { phase_of = "cycle", count = 4, base = 30.0 }\n'
            '"train.cycle_ms" = [50.0, 200.0]\n'
        )
    )

    begins_s = {(case.setup.cycle_ms, case.faults[0]["start_s"]) for case in cases}
    assert begins_s == {
        *((50.0, begin_s) for begin_s in (30.0, 30.0125, 30.025, 30.0375)),
        *((200.0, begin_s) for begin_s in (30.0, 30.05, 30.1, 30.15)),
    }
    assert all(case.factors["fault.0.start_s"] == case.faults[0]["start_s"] for case in cases)


def test_a_users_files_are_stored_with_the_campaign_under_the_same_name(tmp_path: Path) -> None:
    def campaign_in(folder: Path) -> Campaign:
        (folder / "lines").mkdir(parents=True)
        line = Path(str(resources.files("firmware_py.trackdb") / "florence.toml"))
        shutil.copy(line, folder / "lines" / "mine.toml")
        (folder / "a.toml").write_text('train = { line = "lines/mine.toml", end = "I" }')
        return read_campaign(str(folder / "a.toml"))

    here, there = campaign_in(tmp_path / "here"), campaign_in(tmp_path / "there")

    (case,) = plan_cases(here)
    assert case.setup.line == "mine.toml"
    assert list(here.files) == ["mine.toml"]
    assert 'name = "florence"' in here.files["mine.toml"]
    assert here.fingerprint == there.fingerprint


def test_two_files_with_one_name_are_distinguished(tmp_path: Path) -> None:
    text = (resources.files("plant_emulator.consists") / "florence4.toml").read_text("utf-8")
    for folder, content in (("a", text), ("b", text + "\n# other\n")):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "t.toml").write_text(content, encoding="utf-8")
    (tmp_path / "c.toml").write_text(
        '[sweep.factors]\n"train.consist" = ["a/t.toml", "b/t.toml", "florence4"]\n'
    )

    campaign = read_campaign(str(tmp_path / "c.toml"))

    names = [case.setup.consist for case in plan_cases(campaign)]
    assert names[0] == "t.toml"
    assert re.fullmatch(r"t-[0-9a-f]{8}\.toml", names[1])
    assert names[2] == "florence4"
    assert list(campaign.files) == names[:2]


def test_an_error_in_a_users_file_names_that_file(tmp_path: Path) -> None:
    (tmp_path / "t.toml").write_text("name = 3\n")
    (tmp_path / "c.toml").write_text('[train]\nconsist = "t.toml"\n')

    with pytest.raises(CampaignError, match=r"c\.toml:2: train\.consist: .*t\.toml:1: name: 3"):
        read_campaign(str(tmp_path / "c.toml"))


def test_an_unknown_campaign_gets_the_nearest_as_suggestion() -> None:
    with pytest.raises(SettingsError, match="nearest valid shipped name: florence"):
        read_campaign("florenc")
    with pytest.raises(SettingsError, match="no such file"):
        read_campaign("no/such.toml")


@pytest.mark.parametrize("name", shipped_names("metro_hil.campaign.shipped"))
def test_every_shipped_campaign_can_be_set_up(name: str) -> None:
    definition = read_definition(name)

    cases = plan_cases(definition.campaign)
    assert cases
    firsts = {case.scenario: case for case in reversed(cases)}
    for case in firsts.values():
        parts_of(case, definition.bodies[0].sources.paths)


def test_a_scenario_in_python_equals_the_one_in_a_file() -> None:
    text = FULL.replace("atp.warning_margin_mps = 0.5", f"{believed_key()} = 0.5")

    scenario = Scenario(
        name="x",
        title="Runaway traction is stopped",
        requirements=("ACC-05", "INV-03"),
        seeds=2,
        seed_base=7,
        expected={"fails": "inv-04-civil-limit", "margin_min": -2.0},
        stop_at_violation=False,
        train={
            "start": "I",
            "load_ratio": 0.5,
            "cycle_ms": 100,
            "real": {"brake.service.gain_ratio": 0.9},
            "believed": {believed_key(): 0.5},
        },
        timetable={"stops": ("II", "IV"), "dwell_s": {"II": 12.5}},
        fault=[{"kind": "traction_runaway", "when": "speed_mps > 16.6", "accel_mps2": 1.0}],
        sweep={"factors": {"fault.0.start_s": [10.0, 20.0]}},
    )

    assert scenario.cases() == plan_cases(campaign_of(text))
    assert scenario.campaign() == campaign_of(text)
    assert plan_cases(campaign_of(tomli_w.dumps(scenario.table()))) == scenario.cases()


def test_a_wrong_scenario_in_python_is_named() -> None:
    with pytest.raises(CampaignError, match=r"Scenario hop: train\.lod_ratio: unknown key"):
        Scenario(name="hop", train={"lod_ratio": 1}).cases()
