"""Names end with the unit: every float field of a class names its unit."""

import importlib
import pkgutil
import typing
from collections.abc import Iterator
from typing import Final

PACKAGES: Final = (
    *("can_dbc", "zenoh_config", "firmware_py"),
    *("vobc", "plant_emulator", "metro_hil", "metro_tools", "canlog"),
)
UNITS: Final = frozenset(
    {
        *("m", "mm", "mps", "mps2", "mps3", "kmh", "rad"),
        *("s", "ms", "us", "ns", "hz"),
        *("kg", "n", "nm", "pa", "kpa", "ma", "bar"),
        *("w", "kw", "j", "kj", "kwh", "v", "a", "ohm"),
        *("percent", "permille", "ratio", "share", "factor"),
    }
)
QUALIFIERS: Final = frozenset({"min", "max", "mean", "total", "p50", "p90", "p99", "p999"})
"""Qualifiers that may follow the unit, as in `gap_m_min`."""

UNIT_IS_ELSEWHERE: Final = frozenset(
    {
        # The field that holds the value names the unit: `front_m: Interval`.
        *("Interval.best", "Interval.high", "Interval.low"),
        *("ConfidenceInterval.best", "ConfidenceInterval.high", "ConfidenceInterval.low"),
        *("Spread.high", "Spread.low"),
        # Four values of one quantity, which the calling function names.
        *("_Four.emergency", "_Four.permitted", "_Four.service", "_Four.warning"),
        # The unit of the signal that the layout describes.
        *("FieldLayout.maximum", "FieldLayout.minimum", "FieldLayout.offset", "FieldLayout.scale"),
        *("DbcSignal.maximum", "DbcSignal.minimum", "DbcSignal.offset", "DbcSignal.raw_initial"),
        "DbcSignal.scale",
        *("FieldMatch.offset", "FieldMatch.scale"),
        *("SignalSpec.maximum", "SignalSpec.minimum", "SignalSpec.offset", "SignalSpec.scale"),
        # A correlation, and a share of the variance: pure numbers.
        *("FieldMatch.correlation", "_Field.explained"),
        # A number of processes.
        "HostSample.runnable_mean",
        # Named like its option or key, `--odometer-error 0.05`.
        *("RunOptions.odometer_error", "RecordedOptions.odometer_error"),
        *("Setup.odometer_error", "TrainKeys.odometer_error"),
        # The unit of the factor, monitor or expression.
        *("PhaseKeys.base", "RangeKeys.high", "RangeKeys.low", "RangeKeys.step"),
        *("NumberRange.high", "NumberRange.low", "Expression.value_of", "MonitorResult.margin"),
        *("MutantFinding.margin", "_Least.margin"),
        *("Cell.margins", "Sought.margins", "Sought.value"),
        *("ExpectedFailure.margin_max", "ExpectedFailure.margin_min"),
        *("_Linear.constant", "_Linear.factors"),
        *("PlantGrant.inputs", "NodeHello.parameters", "NodeKeys.parameters"),
        # The unit of the setting that the key names.
        *("TunedParameter.high", "TunedParameter.low", "Tuned.after", "Tuned.before"),
        *("FittedKey.first", "FittedKey.high", "FittedKey.low", "FittedKey.trial"),
        *("FittedRide.real", "LeastSquares.values", "TrainFit.values"),
        # The unit of the plotted or compared signal of a log.
        *("Allowed.physical", "SignalDifference.allowed", "SignalDifference.most"),
        "SignalTrace.choices",
        "TrackRange.value",
    }
)


def float_fields() -> Iterator[tuple[str, str]]:
    """Class and field of everything annotated as float, or as float or None."""
    for package in PACKAGES:
        root = importlib.import_module(package)
        for found in pkgutil.walk_packages(root.__path__, f"{package}."):
            if found.name.endswith("__main__"):
                continue
            module = importlib.import_module(found.name)
            for kind in vars(module).values():
                if isinstance(kind, type) and kind.__module__ == module.__name__:
                    yield from _fields(kind)


def _fields(kind: type) -> Iterator[tuple[str, str]]:
    for name, hint in typing.get_type_hints(kind).items():
        if hint is float or float in typing.get_args(hint):
            yield kind.__name__, name


def names_its_unit(name: str) -> bool:
    """Whether the name ends with a unit; `_per_` joins two units, and qualifiers may follow."""
    words = name.split("_")
    while words and words[-1] in QUALIFIERS:
        words.pop()
    if "per" in words[1:-1]:
        return True
    return len(words) > 1 and words[-1] in UNITS


def test_every_float_names_its_unit() -> None:
    mute = {f"{kind}.{name}" for kind, name in float_fields() if not names_its_unit(name)}

    assert mute - UNIT_IS_ELSEWHERE == set()
    assert UNIT_IS_ELSEWHERE - mute == set(), "no longer needed in the list"


def test_instants_are_whole_nanoseconds() -> None:
    assert [f"{kind}.{name}" for kind, name in float_fields() if name.endswith("_ns")] == []


def test_the_rule_distinguishes_names() -> None:
    for name in ("speed_mps", "gap_m_min", "m_per_pulse", "ki_per_s2", "lateness_us_p99"):
        assert names_its_unit(name), name
    for name in ("speed", "gap_min", "mps", "error", "max", "speed_mpss"):
        assert not names_its_unit(name), name


def test_the_search_finds_fields() -> None:
    found = {f"{kind}.{name}" for kind, name in float_fields()}

    assert len(found) > 200
    assert "TractionCommand.force_n" in found
