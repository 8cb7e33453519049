"""Online temporal logic: checked by definition, by another library, at its limits, and in its
refusals."""

import contextlib
import json
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from metro_hil.monitors.reading import FormulaError
from metro_hil.monitors.stl import Formula
from metro_hil.monitors.terms import TermState

NS_PER_S = 1_000_000_000
NAMES = ("a", "b", "c", "flag")
ORACLE = json.loads(Path(__file__).with_name("rtamt_robustness.json").read_text(encoding="utf-8"))


class Signals:
    def __init__(self, **values: float) -> None:
        self.a = self.b = self.c = self.flag = 0.0
        for name, value in values.items():
            setattr(self, name, value)


def formula(text: str) -> Formula:
    return Formula(text, NAMES, ("flag",))


def run(text: str, rows: Sequence[dict[str, float]], step_s: float = 1.0) -> Formula:
    """Feed evenly spaced rows and finish."""
    made = formula(text)
    for index, row in enumerate(rows):
        made.step(round(index * step_s * NS_PER_S), Signals(**row))
    made.finish()
    return made


# By definition.


@dataclass(frozen=True)
class Tree:
    """A formula and its meaning over a whole trace, straight from the definition."""

    text: str
    robustness: Callable[[int], float]
    holds: Callable[[int], bool]
    told: Callable[[int], bool]
    """Whether all samples have arrived on which its margin at this sample depends."""


@dataclass(frozen=True)
class Trace:
    instants_ns: list[int]
    rows: list[dict[str, float]]

    def within(self, index: int, low_ns: int, high_ns: int) -> list[int]:
        at_ns = self.instants_ns[index]
        return [
            other
            for other, other_ns in enumerate(self.instants_ns)
            if at_ns + low_ns <= other_ns <= at_ns + high_ns
        ]


VALUES = st.integers(-3, 3).map(float)


@st.composite
def traces(draw: st.DrawFn) -> Trace:
    """Unevenly spaced samples with many equal values, so that margins of exactly zero occur."""
    gaps = draw(st.lists(st.sampled_from([1, 2, 5, 10]), min_size=1, max_size=14))
    instants = [0]
    for gap in gaps:
        instants.append(instants[-1] + gap * NS_PER_S // 10)
    rows = [{name: draw(VALUES) for name in ("a", "b", "c")} for _ in instants]
    return Trace(instants, rows)


def atoms(trace: Trace) -> st.SearchStrategy[Tree]:
    def make(left: str, sign: str, right: str) -> Tree:
        def sides(index: int) -> tuple[float, float]:
            row = trace.rows[index]
            return row[left], row[right]

        def robustness(index: int) -> float:
            x, y = sides(index)
            return {
                "<": y - x, "<=": y - x, ">": x - y, ">=": x - y,
                "==": -abs(x - y), "!=": abs(x - y),
            }[sign]  # fmt: skip

        def holds(index: int) -> bool:
            x, y = sides(index)
            return {
                "<": x < y, "<=": x <= y, ">": x > y, ">=": x >= y, "==": x == y, "!=": x != y
            }[sign]  # fmt: skip

        return Tree(f"({left} {sign} {right})", robustness, holds, lambda _: True)

    name = st.sampled_from(["a", "b", "c"])
    return st.builds(make, name, st.sampled_from(["<", "<=", ">", ">=", "==", "!="]), name)


INTERVALS = st.tuples(st.integers(0, 12), st.integers(0, 12)).map(sorted)


def opposite(part: Tree) -> Tree:
    return Tree(
        f"not {part.text}", lambda i: -part.robustness(i), lambda i: not part.holds(i), part.told
    )


def joined(word: str, one: Tree, other: Tree) -> Tree:
    def robustness(i: int) -> float:
        x, y = one.robustness(i), other.robustness(i)
        return {"and": min(x, y), "or": max(x, y), "->": max(-x, y)}[word]

    def holds(i: int) -> bool:
        x, y = one.holds(i), other.holds(i)
        return {"and": x and y, "or": x or y, "->": not x or y}[word]

    text = f"({one.text} {word} {other.text})"
    return Tree(text, robustness, holds, lambda i: one.told(i) and other.told(i))


def told_ahead(trace: Trace, parts: Sequence[Tree], end_ns: int) -> Callable[[int], bool]:
    def told(i: int) -> bool:
        reach_ns = trace.instants_ns[i] + end_ns
        return any(
            trace.instants_ns[j] >= reach_ns
            and all(part.told(k) for part in parts for k in range(j + 1))
            for j in range(i, len(trace.instants_ns))
        )

    return told


def timed(trace: Trace, word: str, interval: list[int], part: Tree) -> Tree:
    low_ns, high_ns = (each * NS_PER_S // 10 for each in interval)
    past = word in ("once", "historically")
    greatest = word in ("once", "eventually")

    def window(i: int) -> list[int]:
        return trace.within(i, -high_ns, -low_ns) if past else trace.within(i, low_ns, high_ns)

    def robustness(i: int) -> float:
        values = [part.robustness(j) for j in window(i)]
        pick = max if greatest else min
        return pick(values, default=-math.inf if greatest else math.inf)

    return Tree(
        f"{word}[{interval[0] / 10}:{interval[1] / 10}]({part.text})",
        robustness,
        lambda i: (any if greatest else all)(part.holds(j) for j in window(i)),
        part.told if past else told_ahead(trace, [part], high_ns),
    )


def until(trace: Trace, interval: list[int], one: Tree, other: Tree) -> Tree:
    low_ns, high_ns = (each * NS_PER_S // 10 for each in interval)

    def robustness(i: int) -> float:
        return max(
            (
                min([other.robustness(j), *(one.robustness(k) for k in range(i, j))])
                for j in trace.within(i, low_ns, high_ns)
            ),
            default=-math.inf,
        )

    def holds(i: int) -> bool:
        return any(
            other.holds(j) and all(one.holds(k) for k in range(i, j))
            for j in trace.within(i, low_ns, high_ns)
        )

    text = f"({one.text} until[{interval[0] / 10}:{interval[1] / 10}] {other.text})"
    return Tree(text, robustness, holds, told_ahead(trace, [one, other], high_ns))


def larger(trace: Trace, inner: st.SearchStrategy[Tree]) -> st.SearchStrategy[Tree]:
    words = st.sampled_from(["always", "eventually", "once", "historically"])
    here = st.just(trace)
    return st.one_of(
        st.builds(opposite, inner),
        st.builds(joined, st.sampled_from(["and", "or", "->"]), inner, inner),
        st.builds(timed, here, words, INTERVALS, inner),
        st.builds(until, here, INTERVALS, inner, inner),
    )


@settings(max_examples=150)
@given(data=st.data(), trace=traces())
def test_the_online_result_equals_the_definition(data: st.DataObject, trace: Trace) -> None:
    """Margins match exactly, truth matches a definition without margins, and no result comes too
    early."""
    tree = data.draw(
        st.recursive(atoms(trace), lambda inner: larger(trace, inner), max_leaves=5), label="tree"
    )
    if len(tree.text) > 900:
        return
    online = formula(f"always({tree.text})")

    for at_ns, row in zip(trace.instants_ns, trace.rows, strict=True):
        online.step(at_ns, Signals(**row))
    online.finish()

    told = [i for i in range(len(trace.rows)) if tree.told(i)]
    defined = min((tree.robustness(i) for i in told), default=math.inf)
    assert online.margin == pytest.approx(defined, rel=0.0, abs=1e-300)
    if not told:
        assert online.state is TermState.UNKNOWN
    else:
        assert (online.state is TermState.HOLDS) == all(tree.holds(i) for i in told)
        assert (online.state is TermState.VIOLATED) != (online.state is TermState.HOLDS)


@settings(max_examples=60)
@given(data=st.data(), trace=traces())
def test_a_violation_is_reported_as_soon_as_it_is_certain(
    data: st.DataObject, trace: Trace
) -> None:
    tree = data.draw(
        st.recursive(atoms(trace), lambda inner: larger(trace, inner), max_leaves=3), label="tree"
    )
    online = formula(f"always({tree.text})")
    for count, (at_ns, row) in enumerate(zip(trace.instants_ns, trace.rows, strict=True), 1):
        violated = online.step(at_ns, Signals(**row))

        shorter = Trace(trace.instants_ns[:count], trace.rows[:count])
        again = formula(f"always({tree.text})")
        certain = [again.step(t, Signals(**r)) for t, r in zip(*_columns(shorter), strict=True)]
        assert violated == certain[-1]
        assert violated >= any(certain), "a violation does not heal"


def _columns(trace: Trace) -> tuple[list[int], list[dict[str, float]]]:
    return trace.instants_ns, trace.rows


# By another library, whose results were recorded so that it need not be installed.


@pytest.mark.parametrize("case", ORACLE["cases"], ids=lambda case: case["formula"])
def test_margins_equal_those_of_rtamt(case: dict[str, Any]) -> None:
    """rtamt's offline monitor uses a truncated window as it is; this monitor waits for the whole
    window."""
    trace, text = ORACLE["trace"], case["formula"]
    rows = [dict(zip(trace, values, strict=True)) for values in zip(*trace.values(), strict=True)]
    told = 0

    for index, expected in enumerate(case["robustness"]):
        if run(f"always[{index}:{index}](({text}) or a <= 99)", rows).state is TermState.UNKNOWN:
            break
        told += 1
        margin = run(f"always[{index}:{index}]({text})", rows).margin
        assert margin == pytest.approx(expected, abs=1e-9) if expected else math.isinf(margin)

    assert told >= 18


# Meaning, by example.


def test_the_margin_is_the_least_distance_to_the_limit() -> None:
    speeds = [{"a": value} for value in (1.0, 4.0, 9.5, 3.0)]

    held = run("always(a <= 10)", speeds)

    assert (held.state, held.margin, held.at_ns) == (TermState.HOLDS, 0.5, 2 * NS_PER_S)


def test_a_limit_that_is_met_exactly_holds_unless_it_is_strict() -> None:
    at_limit = [{"a": 10.0}]

    assert run("always(a <= 10)", at_limit).state is TermState.HOLDS
    assert run("always(a < 10)", at_limit).state is TermState.VIOLATED
    assert run("always(not a < 10)", at_limit).state is TermState.HOLDS
    assert run("always(not a <= 10)", at_limit).state is TermState.VIOLATED
    assert run("always(a == 10 and not a != 10)", at_limit).state is TermState.HOLDS


def test_a_boolean_has_a_margin_of_one_either_way() -> None:
    assert run("always(flag > 0.5)", [{"flag": 1.0}]).margin == 1.0
    assert run("always(flag)", [{"flag": 0.0}]).margin == -1.0
    assert run("always(not flag)", [{"flag": 0.0}]).margin == 1.0
    assert run("always(0.5 >= flag)", [{"flag": 0.0}]).margin == 1.0


def test_a_deadline_counts_in_seconds_whatever_the_rate_of_samples() -> None:
    text = "always(flag -> eventually[0:0.3](a <= 0))"

    def cut_after(samples: int, step_s: float) -> TermState:
        rows = [{"flag": 1.0, "a": 1.0 if i < samples else 0.0} for i in range(2 * samples + 50)]
        return run(text, rows, step_s).state

    assert cut_after(30, 0.01) is TermState.HOLDS
    assert cut_after(31, 0.01) is TermState.VIOLATED
    assert cut_after(6, 0.05) is TermState.HOLDS
    assert cut_after(7, 0.05) is TermState.VIOLATED


def test_a_violated_deadline_is_known_when_it_is_over() -> None:
    made = formula("always(flag -> eventually[0:2](a <= 0))")

    told = [made.step(i * NS_PER_S, Signals(flag=1.0, a=1.0)) for i in range(5)]

    assert told == [False, False, True, True, True]


@pytest.mark.parametrize(
    ("text", "values", "state"),
    [
        ("eventually(a >= 3)", [0, 1, 3, 0], TermState.HOLDS),
        ("eventually(a >= 3)", [0, 1, 2, 0], TermState.VIOLATED),
        ("eventually[0:2](a >= 3)", [0, 1, 2, 3], TermState.VIOLATED),
        ("eventually[2:9](a >= 3)", [3, 0, 0], TermState.UNKNOWN),
        ("always[1:2](a >= 1)", [0, 1, 1, 0], TermState.HOLDS),
        ("always[1:9](a >= 1)", [0, 1, 1], TermState.UNKNOWN),
        ("always[1:9](a >= 1)", [0, 1, 0], TermState.VIOLATED),
        ("(a >= 1) until (a >= 3)", [1, 2, 3, 0], TermState.HOLDS),
        ("(a >= 1) until (a >= 3)", [1, 0, 3, 0], TermState.VIOLATED),
        ("(a >= 1) until (a >= 3)", [1, 1, 1], TermState.VIOLATED),
        ("(a >= 1) until[0:1] (a >= 3)", [1, 1, 3], TermState.VIOLATED),
        ("(a >= 1) until[2:5] (a >= 3)", [1, 3, 3], TermState.HOLDS),
        ("not ((a >= 1) until (a >= 3))", [1, 0, 3], TermState.HOLDS),
        ("not ((a >= 1) until (a >= 3))", [1, 1, 3], TermState.VIOLATED),
        ("always(a >= 0) and eventually(a >= 3)", [1, 2, 3], TermState.HOLDS),
        ("always(a >= 1) or eventually(a >= 3)", [0, 2, 2], TermState.VIOLATED),
        ("eventually(a >= 3) -> always(a >= 1)", [3, 0, 1], TermState.VIOLATED),
        ("eventually(a >= 4) -> always(a >= 1)", [3, 0, 1], TermState.HOLDS),
    ],
)
def test_the_top_level_formula_counts_from_the_first_sample(
    text: str, values: list[float], state: TermState
) -> None:
    assert run(text, [{"a": float(value)} for value in values]).state is state


def test_a_truncated_run_does_not_violate_an_open_deadline() -> None:
    for text in ("eventually(a >= 3)", "(a <= 1) until (a >= 3)"):
        made = formula(text)
        made.step(0, Signals(a=0.0))
        made.finish(cut_short=True)

        assert made.state is TermState.UNKNOWN, text


def test_a_premise_that_never_held_makes_a_formula_vacuous() -> None:
    text = "always(flag and a >= 1 -> b <= 2)"

    assert run(text, [{"flag": 1.0, "a": 0.0, "b": 9.0}]).vacuous
    assert not run(text, [{"flag": 1.0, "a": 1.0, "b": 1.0}]).vacuous
    assert not run("always(b <= 2)", [{"b": 1.0}]).vacuous


IDLE = {"flag": 0.0, "a": 0.0, "b": 1.0}
ASKED = {"flag": 1.0, "a": 0.0, "b": 1.0}


@pytest.mark.parametrize(
    "text",
    [
        "always(flag -> b <= 2)",
        "always(not flag or b <= 2)",
        "not eventually(not (flag -> b <= 2))",
        "always(b <= 2 and (flag -> b <= 2))",
        "always(flag -> (b <= 2 -> b <= 2))",
        "always[0:10](always[0:2](flag -> b <= 2))",
        "always(eventually[0:2](flag -> b <= 2))",
        "always(historically(flag -> b <= 2))",
        "always(flag -> b <= 2) and always(b <= 2)",
        "always(b <= 2) and always(flag -> b <= 2)",
        "always(flag -> b <= 2) or always(b >= 9)",
        "always(flag -> eventually[0:1](b <= 2))",
    ],
)
def test_a_premise_counts_at_any_place_of_a_formula(text: str) -> None:
    idle, asked = run(text, [IDLE] * 16), run(text, [*[IDLE] * 4, *[ASKED] * 12])

    assert (idle.state, asked.state) == (TermState.HOLDS, TermState.HOLDS)
    assert idle.vacuous == "its premise never held"
    assert not asked.vacuous


@pytest.mark.parametrize("text", ["always(flag or b <= 2)", "always(not flag or not a >= 1)"])
def test_a_disjunction_without_a_premise_is_not_vacuous(text: str) -> None:
    assert not run(text, [IDLE] * 4).vacuous


@pytest.mark.parametrize("text", ["eventually(flag)", "b <= 2 until flag", "eventually[2:9](flag)"])
def test_a_condition_that_held_from_the_first_sample_did_not_rise(text: str) -> None:
    at_once, later = run(text, [ASKED] * 12), run(text, [*[IDLE] * 4, *[ASKED] * 8])

    assert (at_once.state, later.state) == (TermState.HOLDS, TermState.HOLDS)
    assert "from the first sample on" in at_once.vacuous
    assert not later.vacuous


def test_a_condition_that_was_false_before_its_interval_did_rise() -> None:
    assert not run("eventually[2:9](flag)", [ASKED, IDLE, IDLE, *[ASKED] * 9]).vacuous


def test_a_premise_with_a_deadline_after_the_end_of_the_run_does_not_count() -> None:
    rows = [{"flag": 0.0}, {"flag": 0.0}, {"flag": 1.0}]

    assert run("always(flag -> eventually[0:5](a >= 1))", rows).vacuous
    assert not run("always(flag -> eventually[0:5](a >= 1))", [*rows, *[{"a": 1.0}] * 6]).vacuous


def test_a_division_by_zero_gives_no_result_and_ends_nothing() -> None:
    made = run("always(a / b <= 1)", [{"a": 1.0, "b": 2.0}, {"a": 1.0, "b": 0.0}])

    assert made.broken == "division by zero at 1 s"


def test_memory_stays_bounded_by_the_intervals() -> None:
    """An ever falling signal is the worst case for a running maximum, a rising one for a
    minimum."""
    text = (
        "always(once(a >= 3) or historically(b >= 3) or once[0.1:](a >= 0)"
        " or eventually[0:0.5](a >= 1))"
    ).replace("[0.1:]", "[0.1:0.6]")
    made = formula(text)
    for index in range(20_000):
        made.step(index * NS_PER_S // 100, Signals(a=-index, b=-index))

    assert _queued(made) < 400


def _queued(thing: object, depth: int = 0) -> int:
    """Number of entries of all queues below an object."""
    if depth > 12 or isinstance(thing, int | float | str | bytes):
        return 0
    if isinstance(thing, list | tuple):
        return sum(_queued(each, depth + 1) for each in thing)
    total = len(thing) if type(thing).__name__ == "deque" else 0  # type: ignore[arg-type]
    for kind in type(thing).__mro__:
        for name in getattr(kind, "__slots__", ()):
            total += _queued(getattr(thing, name, 0), depth + 1)
    return total


# Refusals.


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("always(aa <= 3)", ["character 8", "unknown signal aa", "nearest: a"]),
        ("allways(a <= 3)", ["character 1", "nearest: always"]),
        ("always(a <= 3", ["character 14", "')' is expected, not the end"]),
        ("always(a <= 3))", ["character 15", "superfluous"]),
        ("always(a)", ["character 8", "a is not a condition"]),
        ("always((a <= 1) + 2 <= 3)", ["a condition has no value"]),
        ("a <= 3", ["character 3", "first sample only", "always("]),
        ("once(a <= 3)", ["character 1", "first sample only"]),
        ("always(eventually(a <= 3))", ["character 8", "needs an end", "eventually[0:5]"]),
        ("always(a <= 1 until b <= 1)", ["character 15", "needs an end"]),
        ("always[3:1](a <= 1)", ["character 7", "ends before it begins"]),
        ("always[a:1](a <= 1)", ["character 8", "number of seconds"]),
        ("always(a <= 3 ;)", ["character 15", "';'"]),
        ("always(min(a) <= 3)", ["min takes two arguments"]),
        ("always(abs(a, b) <= 3)", ["abs takes one argument"]),
        ("always(open('x') <= 3)", ["unknown signal open"]),
        ("always(and <= 3)", ["'and' cannot stand here"]),
        ("", ["character 1", "ends too early"]),
        ("always(" + "a <= 1 and " * 100 + "a <= 1)", ["longer than 1000 characters"]),
        ("(" * 900 + "a", ["nested too deeply"]),
    ],
)
def test_an_invalid_formula_is_refused_with_its_place(text: str, words: list[str]) -> None:
    with pytest.raises(FormulaError) as refused:
        formula(text)

    for word in words:
        assert word in str(refused.value)


@given(st.text(alphabet="abc<>=()[]:-+*/. 0159andortuilevyhsc", max_size=40))
def test_any_text_is_either_parsed_or_refused(text: str) -> None:
    with contextlib.suppress(FormulaError):
        formula(text)
