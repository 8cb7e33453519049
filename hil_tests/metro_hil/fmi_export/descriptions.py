"""The XML files of an exported FMU: model description, terminals and the manifest of LS-BUS."""

from collections.abc import Sequence
from typing import Final
from xml.sax.saxutils import quoteattr

MIME: Final = 'application/org.fmi-standard.fmi-ls-bus.can; version="1.0.0"'
JSON: Final = "application/json"
TRUTH_REFERENCE: Final = 100
"""Value reference of the first truth signal."""
ABOUT: Final = (
    "Layered Standard for the simulation of bus communication on a Physical Signal Abstraction or "
    "Network Abstraction based level."
)
"""Description that the schema of the layered standard requires."""
HEAD: Final = '<?xml version="1.0" encoding="UTF-8"?>\n'


def model_description(name: str, token: str, truth: Sequence[str], tool: str) -> str:
    """The model description. Value references are those of `shim.c`.

    Args:
        truth: names of the truth signals, which the train alone has.
    """
    signals = "".join(
        f'    <Float64 name={quoteattr(f"truth.{signal}")} valueReference="{number}" '
        'causality="output" variability="discrete" initial="calculated"/>\n'
        for number, signal in enumerate(truth, TRUTH_REFERENCE)
    )
    outputs = [3, 5, 6, *range(TRUTH_REFERENCE, TRUTH_REFERENCE + len(truth))]
    known = "".join(f'    <Output valueReference="{number}"/>\n' for number in outputs)
    first = "".join(
        f'    <InitialUnknown valueReference="{number}"/>\n'
        for number in outputs
        if number >= TRUTH_REFERENCE
    )
    can = f'mimeType={quoteattr(MIME)} maxSize="65536"'
    text = f'mimeType="{JSON}" maxSize="1048576"'
    return (
        f'{HEAD}<fmiModelDescription fmiVersion="3.0" modelName="{name}" '
        f'instantiationToken="{token}" generationTool={quoteattr(tool)}>\n'
        f'  <CoSimulation modelIdentifier="{name}" hasEventMode="true" needsExecutionTool="true" '
        'canHandleVariableCommunicationStepSize="true"/>\n'
        "  <ModelVariables>\n"
        '    <Float64 name="time" valueReference="0" causality="independent" '
        'variability="continuous"/>\n'
        f"{_input('CAN.Rx_Data', 1, can)}"
        '    <Clock name="CAN.Rx_Clock" valueReference="2" causality="input" '
        'variability="discrete" intervalVariability="triggered"/>\n'
        f"{_output('CAN.Tx_Data', 3, can)}"
        '    <Clock name="CAN.Tx_Clock" valueReference="4" causality="input" '
        'variability="discrete" intervalVariability="countdown"/>\n'
        f"{_output('Serial.Tx_Data', 5, text)}"
        f"{_output('Radio.Tx_Data', 6, text)}"
        f"{_input('Serial.Rx_Data', 7, text)}"
        f"{_input('Radio.Rx_Data', 8, text)}"
        '    <Boolean name="CAN.BusNotifications" valueReference="9" causality="parameter" '
        'variability="fixed" start="false"/>\n'
        f"{signals}"
        f"  </ModelVariables>\n  <ModelStructure>\n{known}{first}  </ModelStructure>\n"
        "</fmiModelDescription>\n"
    )


def _input(name: str, reference: int, kind: str) -> str:
    return (
        f'    <Binary name="{name}" valueReference="{reference}" causality="input" '
        f'variability="discrete" clocks="2" {kind}><Start value=""/></Binary>\n'
    )


def _output(name: str, reference: int, kind: str) -> str:
    return (
        f'    <Binary name="{name}" valueReference="{reference}" causality="output" '
        f'variability="discrete" clocks="4" {kind}/>\n'
    )


def terminals() -> str:
    """The network terminal of LS-BUS, with the terminal of its configuration."""
    members = "".join(
        f'      <TerminalMemberVariable variableName="CAN.{name}" memberName="{name}" '
        'variableKind="signal"/>\n'
        for name in ("Rx_Data", "Rx_Clock", "Tx_Data", "Tx_Clock")
    )
    return (
        f'{HEAD}<fmiTerminalsAndIcons fmiVersion="3.0">\n  <Terminals>\n'
        '    <Terminal name="CAN" terminalKind="org.fmi-ls-bus.network-terminal" '
        f'matchingRule="org.fmi-ls-bus.transceiver">\n{members}'
        '      <Terminal name="Configuration" matchingRule="bus" '
        'terminalKind="org.fmi-ls-bus.network-terminal.configuration">\n'
        '        <TerminalMemberVariable variableName="CAN.BusNotifications" '
        'memberName="BusNotifications" variableKind="signal"/>\n      </Terminal>\n'
        "    </Terminal>\n  </Terminals>\n</fmiTerminalsAndIcons>\n"
    )


def manifest() -> str:
    """The manifest of the layered standard."""
    return (
        f'{HEAD}<fmiLayeredStandardManifest xmlns:fmi-ls="http://fmi-standard.org/fmi-ls-manifest" '
        'fmi-ls:fmi-ls-name="org.fmi-standard.fmi-ls-bus" fmi-ls:fmi-ls-version="1.0.0" '
        f'fmi-ls:fmi-ls-description="{ABOUT}"/>\n'
    )
