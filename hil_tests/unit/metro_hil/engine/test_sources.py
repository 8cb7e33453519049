"""Which parts of the sources count in their hash."""

import ast

import pytest

from metro_hil.engine.sources import meaning, modules_of, sources_hash
from metro_hil.run import case

SOURCE = '''"""Module."""
LIMIT_M = 3.0
"""Why."""


def reach_m(way_m: float) -> float:
    """What comes of it."""
    return way_m + LIMIT_M
'''


def meant(source: str) -> str:
    return meaning(ast.parse(source))


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ('"""Module."""', '"""Another sentence."""'),
        ('"""Why."""\n', ""),
        ('    """What comes of it."""\n', "    # A comment instead.\n"),
        ("way_m + LIMIT_M", "(way_m\n            + LIMIT_M)"),
    ],
)
def test_texts_and_layout_do_not_count(old: str, new: str) -> None:
    assert old in SOURCE
    assert meant(SOURCE.replace(old, new)) == meant(SOURCE)


@pytest.mark.parametrize(
    ("old", "new"), [("3.0", "3.1"), ("way_m + LIMIT_M", "LIMIT_M"), ("reach_m", "range_m")]
)
def test_code_counts(old: str, new: str) -> None:
    assert meant(SOURCE.replace(old, new)) != meant(SOURCE)


def test_a_function_with_only_a_docstring_stays_a_function() -> None:
    assert meant('def f() -> None:\n    """Nothing."""\n') == meant("def f() -> None:\n    pass\n")


def test_a_case_runs_through_controller_train_and_codec_but_no_report() -> None:
    modules = modules_of(case.__name__)

    for package in ("vobc", "plant_emulator", "can_dbc", "firmware_py", "zenoh_config"):
        assert any(name.startswith(f"{package}.") for name in modules), package
    assert not any(".report" in name or ".hil_command" in name for name in modules)


def test_the_hash_is_the_same_each_time() -> None:
    assert sources_hash() == sources_hash()
    assert len(sources_hash()) == 16
