"""A co-simulation FMU of FMI 2.0 or 3.0, through FMPy: scalar numbers in, one step, numbers out."""

import contextlib
import shutil
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from firmware_py.settings import SettingsError

EXTRA: Final = "FMUs need FMPy: pip install 'metro-vobc-bench[fmi]'"
KINDS: Final[Mapping[str, str]] = {
    "Real": "Real",
    "Integer": "Integer",
    "Enumeration": "Integer",
    "Boolean": "Boolean",
    **{name: name for name in ("Float32", "Float64", "Int8", "UInt8", "Int16", "UInt16")},
    **{name: name for name in ("Int32", "UInt32", "Int64", "UInt64")},
}
"""Name in FMPy's calls of each type of variable that the bench can use."""
FLOATS: Final = ("Real", "Float32", "Float64")


class FmuError(Exception):
    """The FMU refused a call; the text says which."""


class Fmu:
    """One instance. The order of calls is: set parameters, `start`, and then set, `step`, get."""

    def __init__(self, path: Path, *, events: bool = False) -> None:
        """Read the model description and load the library. Raises SettingsError.

        Args:
            events: whether the FMU has clocks, so that `terminal_node` handles its events.
        """
        try:
            from fmpy import extract, read_model_description
        except ImportError as error:
            raise SettingsError(f"{path}: {EXTRA}") from error
        if not path.is_file():
            raise SettingsError(f"{path}: no such FMU")
        self._path = path
        self._folder = tempfile.mkdtemp(prefix="fmu-")
        self._slave: Any = None
        self._started = False
        try:
            try:
                description = read_model_description(str(path))
                extract(str(path), self._folder)
            except Exception as error:  # FMPy raises plain exceptions.
                raise SettingsError(f"{path}: no valid FMU: {_first_line(error)}") from error
            if description.coSimulation is None:
                raise SettingsError(f"{path}: no co-simulation FMU; export it as co-simulation")
            self._major = int(description.fmiVersion.split(".")[0])
            if self._major not in (2, 3):
                raise SettingsError(f"{path}: FMI {description.fmiVersion}; 2.0 or 3.0 is needed")
            self.variables: dict[str, Any] = {
                each.name: each for each in description.modelVariables
            }
            """Variables of the model description by name."""
            if events and (self._major != 3 or not description.coSimulation.hasEventMode):
                raise SettingsError(f"{path}: a network terminal needs FMI 3.0 with event mode")
            self._slave = self._instantiated(description, events)
        except BaseException:
            self.close()
            raise

    def _instantiated(self, description: Any, events: bool) -> Any:
        from fmpy.fmi2 import FMU2Slave
        from fmpy.fmi3 import FMU3Slave

        made = FMU2Slave if self._major == 2 else FMU3Slave
        token = description.instantiationToken if self._major == 3 else description.guid
        try:
            slave = made(
                guid=token,
                unzipDirectory=self._folder,
                modelIdentifier=description.coSimulation.modelIdentifier,
                instanceName="plant",
            )
            slave.instantiate(**({"eventModeUsed": True} if events else {}))
        except Exception as error:
            raise SettingsError(f"{self._path}: cannot be loaded: {_first_line(error)}") from error
        return slave

    def check(self, name: str, where: str) -> None:
        """Raise SettingsError for a variable that is no scalar number."""
        variable = self.variables[name]
        if variable.type not in KINDS or getattr(variable, "dimensions", None):
            raise SettingsError(f"{where}: {name} is no scalar number but {variable.type}")

    def set(self, name: str, value: float) -> None:
        variable = self.variables[name]
        kind = KINDS[variable.type]
        given: Any = (
            value if kind in FLOATS else value != 0.0 if kind == "Boolean" else round(value)
        )
        self._call(f"set{kind}", [variable.valueReference], [given])

    def get(self, names: Sequence[str]) -> dict[str, float]:
        """Return the present values of these variables."""
        found: dict[str, float] = {}
        by_kind: dict[str, list[str]] = {}
        for name in names:
            by_kind.setdefault(KINDS[self.variables[name].type], []).append(name)
        for kind, some in by_kind.items():
            references = [self.variables[name].valueReference for name in some]
            values = self._call(f"get{kind}", references)
            found.update(zip(some, map(float, values), strict=True))
        return found

    def start(self, start_s: float) -> None:
        """Initialise it with the parameters set before."""
        if self._major == 2:
            self._call("setupExperiment", startTime=start_s)
            self._call("enterInitializationMode")
        else:
            self._call("enterInitializationMode", startTime=start_s)
        self._call("exitInitializationMode")
        self._started = True

    def step(self, from_s: float, step_s: float) -> bool:
        """Advance it; return whether it asks for event mode. Raises FmuError."""
        done = self._call("doStep", currentCommunicationPoint=from_s, communicationStepSize=step_s)
        if self._major == 3 and done[1]:
            raise FmuError(f"doStep at {from_s:g} s: the FMU ends the simulation")
        if self._major == 3 and done[2]:
            raise FmuError(f"doStep at {from_s:g} s: the FMU returns early, which is not allowed")
        return self._major == 3 and bool(done[0])

    @property
    def folder(self) -> Path:
        """The folder with the FMU's files."""
        return Path(self._folder)

    def reference(self, name: str) -> int:
        """Value reference of a variable."""
        return int(self.variables[name].valueReference)

    def call(self, name: str, *args: Any) -> Any:
        """Call a method of FMPy's instance. Raises FmuError."""
        return self._call(name, *args)

    def _call(self, name: str, *args: Any, **options: Any) -> Any:
        try:
            return getattr(self._slave, name)(*args, **options)
        except Exception as error:
            raise FmuError(f"{self._path.name}: {name}: {_first_line(error)}") from error

    def close(self) -> None:
        """End the instance and delete its files."""
        with contextlib.suppress(Exception):  # FMPy raises plain exceptions.
            if self._started:
                self._slave.terminate()
        with contextlib.suppress(Exception):
            if self._slave is not None:
                self._slave.freeInstance()
        self._slave, self._started = None, False
        shutil.rmtree(self._folder, ignore_errors=True)


def _first_line(error: Exception) -> str:
    return (str(error).strip() or type(error).__name__).splitlines()[0]
