"""Describes diagnostic messages: services of UDS and OBD, fault codes of J1939."""

from typing import Final

RESPONSE: Final = 0x40
"""Offset that a positive response adds to the service."""
NEGATIVE: Final = 0x7F
SERVICES: Final = {
    0x01: "OBD CurrentData",
    0x02: "OBD FreezeFrame",
    0x03: "OBD StoredTroubleCodes",
    0x04: "OBD ClearTroubleCodes",
    0x05: "OBD OxygenSensorTest",
    0x06: "OBD MonitoringTestResults",
    0x07: "OBD PendingTroubleCodes",
    0x08: "OBD ControlOperation",
    0x09: "OBD VehicleInformation",
    0x0A: "OBD PermanentTroubleCodes",
    0x10: "DiagnosticSessionControl",
    0x11: "ECUReset",
    0x14: "ClearDiagnosticInformation",
    0x19: "ReadDTCInformation",
    0x22: "ReadDataByIdentifier",
    0x23: "ReadMemoryByAddress",
    0x24: "ReadScalingDataByIdentifier",
    0x27: "SecurityAccess",
    0x28: "CommunicationControl",
    0x29: "Authentication",
    0x2A: "ReadDataByPeriodicIdentifier",
    0x2C: "DynamicallyDefineDataIdentifier",
    0x2E: "WriteDataByIdentifier",
    0x2F: "InputOutputControlByIdentifier",
    0x31: "RoutineControl",
    0x34: "RequestDownload",
    0x35: "RequestUpload",
    0x36: "TransferData",
    0x37: "RequestTransferExit",
    0x38: "RequestFileTransfer",
    0x3D: "WriteMemoryByAddress",
    0x3E: "TesterPresent",
    0x83: "AccessTimingParameter",
    0x84: "SecuredDataTransmission",
    0x85: "ControlDTCSetting",
    0x86: "ResponseOnEvent",
    0x87: "LinkControl",
}
"""Services of ISO 14229-1 and SAE J1979."""
WITH_IDENTIFIER: Final = frozenset({0x22, 0x24, 0x2A, 0x2E, 0x2F})
"""Services that name a data identifier of two bytes."""
WITH_SUBFUNCTION: Final = frozenset(
    {0x10, 0x11, 0x19, 0x27, 0x28, 0x29, 0x2C, 0x31, 0x3E, 0x83, 0x85, 0x86, 0x87}
)
REFUSALS: Final = {
    0x10: "generalReject",
    0x11: "serviceNotSupported",
    0x12: "subFunctionNotSupported",
    0x13: "incorrectMessageLengthOrInvalidFormat",
    0x14: "responseTooLong",
    0x21: "busyRepeatRequest",
    0x22: "conditionsNotCorrect",
    0x24: "requestSequenceError",
    0x25: "noResponseFromSubnetComponent",
    0x26: "failurePreventsExecutionOfRequestedAction",
    0x31: "requestOutOfRange",
    0x33: "securityAccessDenied",
    0x34: "authenticationRequired",
    0x35: "invalidKey",
    0x36: "exceedNumberOfAttempts",
    0x37: "requiredTimeDelayNotExpired",
    0x70: "uploadDownloadNotAccepted",
    0x71: "transferDataSuspended",
    0x72: "generalProgrammingFailure",
    0x73: "wrongBlockSequenceCounter",
    0x78: "requestCorrectlyReceived-ResponsePending",
    0x7E: "subFunctionNotSupportedInActiveSession",
    0x7F: "serviceNotSupportedInActiveSession",
}
DM1, DM2 = 65226, 65227
FAULTS: Final = {DM1: "DM1", DM2: "DM2"}
"""Messages with active and with previously active trouble codes."""
LAMPS: Final = (("MIL", 6), ("RSL", 4), ("AWL", 2), ("PL", 0))
"""Lamps of the first byte, each with its bit position."""
FAULT_BYTES: Final = 4


def uds_text(data: bytes) -> str:
    """Return the service of a message and its data identifier or subfunction; empty if unknown."""
    if not data:
        return ""
    if data[0] == NEGATIVE and len(data) >= 3:
        service = SERVICES.get(data[1], f"service {data[1]:02X}")
        return f"{service} refused: {REFUSALS.get(data[2], f'code {data[2]:02X}')}"
    for code, way in ((data[0], ""), (data[0] - RESPONSE, " response")):
        if code in SERVICES:
            return f"{SERVICES[code]}{way}{_detail(code, data)}"
    return ""


def service_name(head: int) -> str:
    """Return the service that the first byte of a message names."""
    if head == NEGATIVE:
        return "refused"
    if head in SERVICES:
        return SERVICES[head]
    response = SERVICES.get(head - RESPONSE)
    return f"{response} response" if response else f"service {head:02X}"


def _detail(code: int, data: bytes) -> str:
    if code in WITH_IDENTIFIER and len(data) >= 3:
        return f" {data[1]:02X}{data[2]:02X}"
    if code in WITH_SUBFUNCTION and len(data) >= 2:
        return f" {data[1] & 0x7F:02X}"
    return f" PID {data[1]:02X}" if code < 0x10 and len(data) >= 2 else ""


def fault_text(data: bytes) -> str:
    """Return the lamps that are on and the trouble codes of a DM1 or DM2 message (J1939-73)."""
    if len(data) < 2:
        return "too short"
    lamps = [name for name, place in LAMPS if data[0] >> place & 3 == 1]
    parts = [f"lamps {' '.join(lamps) or 'off'}"]
    for at in range(2, len(data) - FAULT_BYTES + 1, FAULT_BYTES):
        low, middle, high, count = data[at : at + FAULT_BYTES]
        number, failure = low | middle << 8 | (high >> 5) << 16, high & 31
        if (number, failure) in ((0, 0), (0x7FFFF, 31)):
            continue
        parts.append(f"SPN {number} FMI {failure} x{count & 0x7F}")
    return ", ".join(parts) if len(parts) > 1 else f"{parts[0]}, no fault"
