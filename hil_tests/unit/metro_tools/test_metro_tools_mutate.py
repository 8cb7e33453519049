"""The mutation driver: its mutations, killed and surviving mutants, and the list of equivalents."""

import ast
from pathlib import Path

import pytest

from metro_tools.mutate.__main__ import main
from metro_tools.mutate.forks import Pool
from metro_tools.mutate.mutations import mutants_of, mutated
from metro_tools.mutate.result import PAGE_FILE
from metro_tools.mutate.targets import (
    EQUIVALENTS_FILE,
    TARGETS_FILE,
    read_equivalents,
    read_groups,
)

SPEED = '''"""A planted module."""

LIMITS_MPS = {"tunnel": 15.0}


def over(speed_mps, limit_mps):
    return speed_mps >= limit_mps


def limit(where):
    return LIMITS_MPS[where]


def braking_m(speed_mps, decel_mps2):
    def square(value):
        return value * value

    if speed_mps < 0:
        speed_mps += 1
    return square(speed_mps) / (2 * decel_mps2)
'''
GOOD_TESTS = """
import pytest
from planted.speed import braking_m, limit, over

def test_over():
    assert [over(v, 5.0) for v in (4.9, 5.0, 5.1)] == [False, True, True]

def test_limit():
    assert limit("tunnel") == 15.0

def test_braking():
    assert braking_m(10.0, 1.0) == 50.0
    assert braking_m(6.0, 0.5) == 36.0
    assert braking_m(-0.25, 1.0) == 0.28125
    assert braking_m(0.5, 1.0) == 0.125
    assert braking_m(0.0, 1.0) == 0.0
"""


@pytest.fixture
def planted(tmp_path: Path) -> Path:
    """A checkout with one module, its tests, and an empty list of equivalent mutants."""
    for name, text in (
        ("planted/__init__.py", ""),
        ("planted/speed.py", SPEED),
        ("tests/test_speed.py", GOOD_TESTS),
        (TARGETS_FILE, '[speed]\nmodules = ["planted/speed.py"]\ntests = ["tests/test_*.py"]\n'),
        (EQUIVALENTS_FILE, ""),
    ):
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
    return tmp_path


def run(root: Path, *args: str) -> int:
    return main(["--root", str(root), "--jobs", "1", *args])


def test_mutants_of_all_kinds_in_functions_and_tables_are_killed(
    planted: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    status = run(planted)

    told = capsys.readouterr().out
    assert (status, told.splitlines()[-1].split()) == (
        0,
        ["all", str(len(mutants_of(SPEED))), str(len(mutants_of(SPEED))), "0", "0", "100.0", "%"],
    )


def test_an_untested_boundary_survives_and_is_shown_with_its_command(
    planted: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    tests = planted / "tests/test_speed.py"
    tests.write_text(
        GOOD_TESTS.replace("(4.9, 5.0, 5.1)", "(4.9, 5.1)").replace(
            "[False, True, True]", "[False, True]"
        )
    )

    status = run(planted)

    told = capsys.readouterr().out
    (survivor,) = [m for m in mutants_of(SPEED) if m.after == "return speed_mps > limit_mps"]
    assert status == 1
    assert "  - return speed_mps >= limit_mps\n  + return speed_mps > limit_mps\n" in told
    assert f'make mutate MUTATE_ARGS="planted/speed.py --only {survivor.key}"' in told
    assert told.count("again:") == 1

    assert run(planted, "planted/speed.py", "--only", survivor.key) == 1
    assert f"{survivor.key}: survived" in capsys.readouterr().out


def test_a_survivor_with_a_reason_counts_as_equivalent_and_a_stale_entry_is_an_error(
    planted: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    entry = (
        '[[mutant]]\nmodule = "planted/speed.py"\nfunction = "{}"\nmutation = "{}"\nwhy = "{}"\n'
    )
    tests = planted / "tests/test_speed.py"
    tests.write_text(GOOD_TESTS.replace("    assert braking_m(0.0, 1.0) == 0.0\n", ""))
    assert run(planted) == 1
    named = entry.format("braking_m", "if speed_mps < 0:  ->  if speed_mps <= 0:", "0 is 0")

    (planted / EQUIVALENTS_FILE).write_text(named)
    assert run(planted) == 0

    (planted / EQUIVALENTS_FILE).write_text(named + entry.format("over", "a  ->  b", "gone"))
    assert run(planted) == 1
    assert "over: a  ->  b: this mutant does not exist any more" in capsys.readouterr().err

    tests.write_text(GOOD_TESTS)
    (planted / EQUIVALENTS_FILE).write_text(named)
    assert run(planted, "--fresh") == 1
    assert "tests/test_speed.py::test_braking detects it" in capsys.readouterr().err

    (planted / EQUIVALENTS_FILE).write_text(named.replace("0 is 0", " "))
    assert run(planted) == 2
    assert "give the argument for this equivalent mutant" in capsys.readouterr().err


def test_only_mutants_that_a_change_can_affect_are_tried_again(
    planted: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    count = len(mutants_of(SPEED))
    tests, module = planted / "tests/test_speed.py", planted / "planted/speed.py"
    blind = GOOD_TESTS.replace("(4.9, 5.0, 5.1)", "(4.9, 5.1)").replace("False, True, True", "0, 1")

    def tried(*args: str) -> int:
        run(planted, *args)
        return int(capsys.readouterr().err.split()[1])

    assert tried() == count
    assert tried() == 0
    tests.write_text(GOOD_TESTS + "\ndef test_more():\n    assert limit\n")
    assert tried() == 0
    tests.write_text(blind)
    by_over = tried()
    assert 0 < by_over < count
    assert tried() == 0
    tests.write_text(GOOD_TESTS)
    assert 0 < tried() <= by_over
    module.write_text(SPEED + "\n# The same, but who knows.\n")
    assert tried() == count
    assert tried("--fresh") == count


def test_the_score_is_written_only_for_all_modules(
    planted: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    count = len(mutants_of(SPEED))
    (planted / "docs").mkdir()

    assert run(planted, "--write", "planted/speed.py") == 2
    assert run(planted, "--write") == 0

    page = (planted / PAGE_FILE).read_text()
    assert f"**{count} of {count} mutants are detected (100.0 %); 0 more are equivalent" in page
    assert f"| `planted/speed.py` | {count} | {count} | 0 | 0 | 100.0 % |" in page
    assert capsys.readouterr().err.startswith("mutate: --write needs a run of all modules\n")


def test_the_number_of_hypothesis_examples_is_limited(planted: Path) -> None:
    tests = planted / "tests/test_speed.py"
    tests.write_text(
        GOOD_TESTS
        + """
from hypothesis import given, settings, strategies

SEEN = []

@settings(max_examples=1000)
@given(strategies.integers())
def test_each(number):
    SEEN.append(number)
    assert len(SEEN) < 100
"""
    )

    assert run(planted) == 0


def test_tests_that_fail_without_a_mutation_prove_nothing(
    planted: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (planted / "tests/test_speed.py").write_text(GOOD_TESTS + "\ndef test_red():\n    assert 0\n")

    assert run(planted) == 2
    assert "fails even without a mutant: tests/test_speed.py::test_red" in capsys.readouterr().err


def test_a_module_without_a_group_is_refused_by_name(
    planted: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(planted, "planted/brake.py") == 2
    assert "planted/brake.py: in no group" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("source", "after"),
    [
        ("def f(a, b):\n    return a < b", {"return a <= b", "return a >= b", "return None"}),
        ("def f(a):\n    return min(a, 2)", {"return max(a, 2)", "return min(a, 3)"}),
        ("def f(a):\n    return a.low", {"return a.high"}),
        ("def f(a, b):\n    return a and b", {"return a", "return b", "return a or b"}),
        ("def f(a):\n    if a.ready:\n        a.go()", {"if not a.ready:", "pass"}),
        ("LIMIT_MPS = 10.0", {"LIMIT_MPS = 11.0"}),
        ("def f(a=True):\n    pass", {"def f(a=False):"}),
        ("TABLE = (A, B)", {"TABLE = (A,)", "TABLE = (B,)"}),
        ("def f(a):\n    return a in (A, B)", {"return a in (A,)", "return a not in (A, B)"}),
    ],
)
def test_each_kind_of_mutation_is_generated(source: str, after: set[str]) -> None:
    assert after <= {mutant.after for mutant in mutants_of(source)}


@pytest.mark.parametrize(
    "source",
    [
        '"""Words."""',
        "def f(a: int = A) -> int | None:\n    assert a > 0",
        "Sent = tuple[tuple[int, bytes], ...]",
        '__all__ = ["a", "b"]',
        "import a",
    ],
)
def test_code_without_effect_on_a_train_is_not_mutated(source: str) -> None:
    assert mutants_of(source) == []


def test_every_mutant_compiles_differs_and_has_a_unique_name() -> None:
    whole = ast.dump(ast.parse(SPEED))
    mutants = mutants_of(SPEED)

    changed = [mutated(SPEED, mutant.number) for mutant in mutants]

    assert all(compile(tree, "speed.py", "exec") for tree in changed)
    assert all(ast.dump(tree) != whole for tree in changed)
    assert len({mutant.key for mutant in mutants}) == len(mutants)


def test_every_equivalent_is_a_mutant_of_the_present_source(checkout: Path) -> None:
    entries = read_equivalents(checkout)
    mutants = {
        (module, mutant.function, mutant.mutation)
        for module in {entry.module for entry in entries}
        for mutant in mutants_of((checkout / module).read_text(encoding="utf-8"))
    }

    assert [e for e in entries if (e.module, e.function, e.mutation) not in mutants] == []
    assert all(entry.why.endswith(".") for entry in entries)


def test_no_module_of_protection_and_odometry_is_left_out(checkout: Path) -> None:
    meant = {
        str(path.relative_to(checkout))
        for folder in ("vobc/atp", "vobc/odometry")
        for path in (checkout / folder).glob("*.py")
        if path.name != "__init__.py"
    }

    assert meant <= {module for group in read_groups(checkout) for module in group.modules}


def test_a_child_with_more_output_than_a_pipe_holds_ends() -> None:
    told = "a long name of a test\n" * 20_000
    ended: list[tuple[tuple[str, int], int, str]] = []
    pool = Pool(2, lambda name, code, text: ended.append((name, code, text)))
    for number in range(3):
        pool.start(("speed.py", number), lambda pipe: 0 * pipe.write(told), 1.0)
    pool.drain()
    assert sorted(ended) == [(("speed.py", number), 0, told) for number in range(3)]
