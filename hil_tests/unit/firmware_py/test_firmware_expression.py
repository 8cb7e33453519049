"""Expressions of users: Python's arithmetic over named signals, and nothing else."""

from dataclasses import make_dataclass
from types import SimpleNamespace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_py.expression import ExpressionError, compile_expression

NAMES = ("speed_mps", "front_m", "doors_locked")
numbers = st.floats(-1e6, 1e6, allow_nan=False)


@st.composite
def texts(draw: st.DrawFn, depth: int = 3) -> str:
    """Well-formed expressions over NAMES."""
    if depth == 0 or draw(st.booleans()):
        return draw(st.sampled_from((*NAMES, "2", "0.5", "1e3")))
    left, right = draw(texts(depth - 1)), draw(texts(depth - 1))
    form = draw(
        st.sampled_from(
            [
                *("({} + {})", "({} - {})", "({} * {})", "({} < {})", "({} >= {})"),
                *("({} and {})", "({} or {})", "max({}, {})", "min({}, {})"),
                *("(abs({}) == {})", "(not {} or -{} != 1)"),
            ]
        )
    )
    return form.format(left, right)


@given(texts(), numbers, numbers, numbers)
def test_the_value_equals_that_of_python(
    text: str, speed: float, front: float, doors: float
) -> None:
    signals = dict(zip(NAMES, (speed, front, doors), strict=True))

    value = compile_expression(text, NAMES)(SimpleNamespace(**signals))

    assert value == float(eval(text, {}, signals))  # noqa: S307 - the oracle


def test_the_names_in_an_expression_are_listed() -> None:
    expression = compile_expression("abs(front_m) > 3 and speed_mps < 1", NAMES)

    assert expression.names == {"front_m", "speed_mps"}


def test_true_and_false_are_numbers() -> None:
    signals = make_dataclass("Signals", NAMES)(1.0, 2.0, 3.0)

    assert compile_expression("speed_mps < 2", NAMES)(signals) == 1.0
    assert compile_expression("speed_mps > 2", NAMES)(signals) == 0.0


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("sped_mps > 3", "unknown signal sped_mps; nearest: speed_mps"),
        ("xyz > 3", "unknown signal xyz; known: doors_locked, front_m, speed_mps"),
        ("speed_mps >", "not an expression"),
        ("", "not an expression"),
        ("speed_mps.real", "attribute is not allowed"),
        ("speed_mps[0]", "subscript is not allowed"),
        ("(lambda: 1)()", "only abs, min, max can be called"),
        ("__import__('os').system('x')", "only abs, min, max can be called"),
        ("abs", "unknown signal abs"),
        ("min(a=1, b=2)", "min takes plain arguments"),
        ("max()", "max takes two arguments or more"),
        ("min(speed_mps)", "min takes two arguments or more"),
        ("abs(speed_mps, 1)", "abs takes one argument"),
        ("max(1, *speed_mps)", "starred is not allowed"),
        ("'text' == speed_mps", "'text' is not a number"),
        ("None", "None is not a number"),
        ("1 if speed_mps else 2", "ifexp is not allowed"),
        ("[speed_mps]", "list is not allowed"),
        ("speed_mps ** 9999", "pow is not allowed"),
        ("(front_m := 3)", "namedexpr is not allowed"),
        ("speed_mps < " + "9" * 2000, "longer than 1000 characters"),
        ("(" * 300 + "1" + ")" * 300, "not an expression"),
        ("\0", "not an expression"),
    ],
)
def test_anything_else_is_refused_with_a_message(text: str, words: str) -> None:
    with pytest.raises(ExpressionError) as raised:
        compile_expression(text, NAMES)

    assert words in str(raised.value)


STATES = {"state": {"nominal": 1.0, "emergency": 4.0}}


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("state == 'emergency'", 1.0),
        ('"nominal" < state and speed_mps > 2', 1.0),
        ("state != 'emergency' or state == 'nominal'", 0.0),
        ("'nominal' < state <= 'emergency'", 1.0),
    ],
)
def test_a_signal_is_compared_with_the_name_of_a_value(text: str, value: float) -> None:
    expression = compile_expression(text, ("state", *NAMES), STATES)

    assert expression(SimpleNamespace(state=4.0, speed_mps=3.0)) == value
    assert expression.names <= {"state", "speed_mps"}


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("state == 'emergancy'", "state is never 'emergancy'; nearest: emergency"),
        ("state == 'xyz'", "state is never 'xyz'; known: nominal, emergency"),
        ("speed_mps == 'nominal'", "'nominal' is not a number; signals with named values: state"),
        ("state + 'nominal' > 1", "'nominal' is not a number"),
    ],
)
def test_an_unknown_name_of_a_value_is_refused(text: str, words: str) -> None:
    with pytest.raises(ExpressionError) as raised:
        compile_expression(text, ("state", *NAMES), STATES)

    assert words in str(raised.value)


@given(st.text(max_size=40))
def test_any_text_is_either_compiled_or_refused(text: str) -> None:
    try:
        expression = compile_expression(text, NAMES)
    except ExpressionError:
        return
    assert expression.names <= set(NAMES)
