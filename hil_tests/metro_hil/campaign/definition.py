"""A scenario as in its file, from which points are made for any values of its factors."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

from firmware_py import settings
from firmware_py.settings import SettingsError
from metro_hil.campaign.factors import CyclePhase, where
from metro_hil.campaign.plan import SweepPoint
from metro_hil.campaign.problems import Findings, attempt
from metro_hil.campaign.sampled import FAULTS, faults_words
from metro_hil.campaign.schema import BranchKeys, ControllerKeys, PlantKeys
from metro_hil.campaign.sources import Sources
from metro_hil.campaign.tables import ConfigTable, KeyMissingError, with_value
from metro_hil.campaign.train import DEFAULT, read_setup
from metro_hil.model.case import Branch, ControllerSpec, PlantSpec
from metro_hil.model.frame_names import check_bus_fault
from plant_emulator.faults.plan import read_fault

STATION_MEASURES: Final = ("stop_*_error_m", "stop_*_run_s")
"""Patterns of the measures of each station, in addition to those of every case."""

PARTS: Final[Mapping[str, tuple[str, ...]]] = {
    "setup": ("train", "timetable"),
    "faults": ("fault",),
    "monitors": ("monitor",),
    "controller": ("controller",),
    "plant": ("plant",),
    "branch": ("branch",),
}
"""The parts of a point, and the tables from which each is read."""


@dataclass(frozen=True, slots=True)
class Body:
    """The tables of one scenario, including all that it inherits, from which points are made."""

    raw: ConfigTable
    invariants: str | tuple[str, ...]
    sources: Sources

    def parts(self, names: Sequence[str], findings: Findings) -> dict[str, Any]:
        """Read the named parts of a point; a part with problems, which are reported, is None."""
        readers: dict[str, Callable[[], Any]] = {
            "setup": lambda: read_setup(self.raw, self.sources, findings),
            "faults": lambda: self._faults(findings),
            "monitors": lambda: self._monitors(findings),
            "controller": lambda: self._controller(findings),
            "plant": lambda: self._plant(findings),
            "branch": lambda: self._branch(findings),
        }
        return {name: readers[name]() for name in names}

    def check_fit(self, parts: Mapping[str, Any]) -> Findings:
        """Problems of the faults with the setup of a point that is valid otherwise."""
        findings = Findings()
        self.sources.faults.check(parts["setup"], parts["faults"], findings)
        return findings

    def with_values(self, values: Mapping[str, Any]) -> "Body":
        """The scenario with other values by key. Raises KeyMissingError with reason and key."""
        raw = self.raw
        for key, value in values.items():
            try:
                raw = with_value(raw, key, value)
            except KeyMissingError as error:
                raise KeyMissingError(error.args[0], key) from None
        return Body(raw, self.invariants, self.sources)

    def cycle_ms(self) -> float:
        value = self.raw.get("train", {}).get("cycle_ms", DEFAULT.cycle_ms)
        return float(value) if isinstance(value, int | float) else DEFAULT.cycle_ms

    def _faults(self, findings: Findings) -> tuple[ConfigTable, ...]:
        tables = self.raw.get("fault", [])
        for index, table in enumerate(tables):
            key = f"fault[{index}]"
            if not isinstance(table, dict):
                findings.add(key, f"{table!r} is not a table")
                continue
            attempt(_fault_reader(index), table, key, findings)
        return tuple(tables)

    def _monitors(self, findings: Findings) -> tuple[ConfigTable, ...]:
        from metro_hil.metrics.case import NAMES
        from metro_hil.monitors import read_monitors

        measures = (*NAMES, *STATION_MEASURES)
        tables = self.raw.get("monitor", [])
        before = len(findings.found)
        for index, table in enumerate(tables):
            # One at a time, so that one wrong monitor does not hide another.
            alone = Findings()
            key = "monitor[0]"
            if isinstance(table, dict):
                attempt(lambda t: self._monitor(t, measures), table, key, alone)
            else:
                alone.add(key, f"{table!r} is not a table")
            for where_alone, what in alone.found:
                findings.add(where_alone.replace(key, f"monitor[{index}]", 1), what)
        if len(findings.found) == before:
            try:
                read_monitors(tables, "", self.invariants)
            except SettingsError as error:
                findings.add_text(str(error), "monitor", ())
        return tuple(tables)

    def _monitor(self, table: ConfigTable, measures: Sequence[str]) -> object:
        """Read a single monitor. Raises SettingsError."""
        from metro_hil.monitors import read_monitors

        invariants = self.invariants if table.get("invariant") == "all" else "none"
        return read_monitors([table], "", invariants, measures)

    def _controller(self, findings: Findings) -> ControllerSpec | None:
        keys = attempt(
            lambda table: settings.build(ControllerKeys, table, "", "controller"),
            self.raw.get("controller", {}),
            "controller",
            findings,
        )
        if keys is None:
            return None
        return ControllerSpec(
            kind=keys.kind.value, path=keys.path, command=keys.command, lease_s=keys.lease_s
        )

    def _plant(self, findings: Findings) -> PlantSpec | None:
        keys = attempt(
            lambda table: settings.build(PlantKeys, table, "", "plant"),
            self.raw.get("plant", {}),
            "plant",
            findings,
        )
        if keys is None:
            return None
        return PlantSpec(
            kind=keys.kind.value,
            command=keys.command,
            mapping=keys.mapping,
            nodes=keys.nodes,
            lease_s=keys.lease_s,
        )

    def _branch(self, findings: Findings) -> Branch | None:
        if "branch" not in self.raw:
            return None
        keys = attempt(
            lambda table: settings.build(BranchKeys, table, "", "branch"),
            self.raw["branch"],
            "branch",
            findings,
        )
        return None if keys is None else Branch(seed=keys.seed, when=keys.when)


def _fault_reader(index: int) -> Callable[[dict[str, Any]], object]:
    def read(table: dict[str, Any]) -> object:
        plan = read_fault(table, index, "")
        try:
            check_bus_fault(plan)
        except SettingsError as error:
            # Use the form of the other readers: the source, empty here, comes first.
            raise SettingsError(f": {error}") from error
        return plan

    return read


def _as_text(key: str, value: Any) -> Any:
    """The value as a factor of the case; tables become text, so that they can be compared."""
    if key == FAULTS:
        return faults_words(value)
    if isinstance(value, dict):
        return ", ".join(f"{name} {item}" for name, item in value.items())
    return value


class PointMaker:
    """Makes points of one scenario; reads again only the parts that its factors change."""

    def __init__(self, body: Body, keys: Sequence[str], findings: Findings) -> None:
        """Report all problems that the scenario has apart from its sweep."""
        self._body = body
        touching = {
            part: tuple(key for key in keys if key.partition(".")[0] in tables)
            for part, tables in PARTS.items()
        }
        self._changed = {part: some for part, some in touching.items() if some}
        fixed = [part for part in PARTS if part not in self._changed]
        before = len(findings.found)
        self._fixed = body.parts(fixed, findings)
        self._valid = len(findings.found) == before
        self._before = Findings()
        own = {**self._fixed, **body.parts(tuple(self._changed), self._before)}
        if self._valid and not self._before:
            self._before = body.check_fit(own)
        self._read: dict[tuple[str, ...], tuple[Any, Findings]] = {}

    def report_body(self, findings: Findings) -> None:
        """Report problems in the parts that the sweep changes, when the sweep itself fails.

        A missing key is not reported, because the sweep may have been meant to set it.
        """
        for key, what in self._before.found:
            if what != "missing key":
                findings.add(key, what)

    def point(
        self, number: int, values: Mapping[str, Any], findings: Findings
    ) -> SweepPoint | None:
        """Make one point; None if it has problems, which are reported.

        Problems that the scenario also has without the sweep are reported as the scenario's own.
        """
        body = self._body
        try:
            plain = {key: item for key, item in values.items() if not isinstance(item, CyclePhase)}
            body = body.with_values(plain)
            factors = dict(values)
            for key, item in values.items():
                if isinstance(item, CyclePhase):
                    factors[key] = item.instant_s(body.cycle_ms())
                    body = body.with_values({key: factors[key]})
        except KeyMissingError as error:
            findings.add(where(error.args[1]), error.args[0])
            return None
        parts = dict(self._fixed)
        values_of = dict(factors)
        factors = {key: _as_text(key, item) for key, item in factors.items()}
        fine = True
        for part, keys in self._changed.items():
            parts[part], seen = self._part(body, part, [values_of[key] for key in keys])
            fine = fine and not seen
            for key, what in seen.found:
                self._report(key, what, factors, findings)
        if fine and self._valid:
            seen = self._fit(body, parts, values_of)
            fine = not seen
            for key, what in seen.found:
                self._report(key, what, factors, findings)
        return SweepPoint(number=number, factors=factors, **parts) if fine else None

    def _part(self, body: Body, part: str, values: Sequence[Any]) -> tuple[Any, Findings]:
        """Read one part with its problems; points with equal values share the part."""
        key = (part, *map(repr, values))
        if key not in self._read:
            seen = Findings()
            self._read[key] = body.parts((part,), seen)[part], seen
        return self._read[key]

    def _fit(self, body: Body, parts: Mapping[str, Any], values: Mapping[str, Any]) -> Findings:
        """Problems of the faults with the setup; points with equal values share them."""
        keys = [key for part in ("setup", "faults") for key in self._changed.get(part, ())]
        fit = ("fit", *(repr(values[key]) for key in keys))
        if fit not in self._read:
            self._read[fit] = None, body.check_fit(parts)
        return self._read[fit][1]

    def _report(self, key: str, what: str, factors: Mapping[str, Any], findings: Findings) -> None:
        if (key, what) in self._before.found:
            findings.add(key, what)
            return
        # The text about an override begins with the override's key.
        path = f"{key.replace('[', '.').replace(']', '')}.{what}".replace(": ", ".")
        for factor, value in factors.items():
            if factor != FAULTS and path.startswith((f"{factor}.", f"{factor} ")):
                said = what if repr(value) in what or str(value) in what else f"{value!r}: {what}"
                findings.add(where(factor), said)
                return
        words = ", ".join(f"{factor} = {value!r}" for factor, value in factors.items())
        findings.add("sweep", f"with {words}: {key}: {what}")
