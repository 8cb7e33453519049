"""Builds FMUs of small LS-BUS nodes for tests."""

import subprocess
import zipfile
from pathlib import Path
from typing import Final

from metro_hil.fmi_export.descriptions import manifest, terminals
from metro_hil.fmi_export.export import binaries_folder

SOURCE: Final = Path(__file__).with_name("node.c")
KINDS: Final = (
    *("SENDER", "ECHO", "CONFINED", "STUBBORN", "WAKER", "SLEEPER", "GARBLER", "BURSTER"),
    *("TICKER", "CREEPER", "TALKER", "HANGER", "CRASHER", "QUITTER", "LAGGARD"),
)
"""Kinds of nodes by their number; see `node.c`."""
PARAMETERS: Final = ("kind", "identifier", "period_us", "bit_rate", "discard")
CLOCKS: Final = {
    "counting": 'causality="input" intervalVariability="countdown"',
    "triggered": 'causality="output" intervalVariability="triggered"',
}
"""The transmit clock of each FMU, by its name."""
DESCRIPTION: Final = """\
<fmiModelDescription fmiVersion="3.0" modelName="{name}" instantiationToken="{name}">
  <CoSimulation modelIdentifier="{name}" hasEventMode="true"
    canHandleVariableCommunicationStepSize="true"/>
  <ModelVariables>
    <Float64 name="time" valueReference="0" causality="independent" variability="continuous"/>
    <Binary name="CAN.Rx_Data" valueReference="1" causality="input" variability="discrete"
      clocks="2"><Start value=""/></Binary>
    <Clock name="CAN.Rx_Clock" valueReference="2" causality="input"
      intervalVariability="triggered"/>
    <Binary name="CAN.Tx_Data" valueReference="3" causality="output" variability="discrete"
      clocks="4"/>
    <Clock name="CAN.Tx_Clock" valueReference="4" {clock}/>
    <Boolean name="CAN.BusNotifications" valueReference="5"
      causality="parameter" variability="fixed" start="false"/>
    {parameters}
  </ModelVariables>
  <ModelStructure><Output valueReference="3"/></ModelStructure>
</fmiModelDescription>
"""


def make_nodes(folder: Path, compiler: str) -> dict[str, Path]:
    """Build the FMU of each kind of clock."""
    library = folder / "node"
    flags = ("-std=gnu99", "-w", "-O1", "-fPIC", "-shared")
    subprocess.run([compiler, *flags, str(SOURCE), "-o", str(library)], check=True)
    place, suffix = binaries_folder()
    parameters = "\n    ".join(
        f'<Int32 name="{name}" valueReference="{number}" causality="parameter" '
        f'variability="fixed" start="0"/>'
        for number, name in enumerate(PARAMETERS, 6)
    )
    made = {}
    for name, clock in CLOCKS.items():
        made[name] = folder / f"{name}.fmu"
        with zipfile.ZipFile(made[name], "w") as fmu:
            text = DESCRIPTION.format(name=name, clock=clock, parameters=parameters)
            fmu.writestr("modelDescription.xml", text)
            fmu.writestr("terminalsAndIcons/terminalsAndIcons.xml", terminals())
            fmu.writestr("extra/org.fmi-standard.fmi-ls-bus/fmi-ls-manifest.xml", manifest())
            fmu.write(library, f"{place}/{name}{suffix}")
    return made
