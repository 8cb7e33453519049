"""Verdicts of generated code and the reasons of the codec."""

from can_dbc.codec import Reason

VERDICTS = {
    2: Reason.WRONG_LENGTH,
    3: Reason.WRONG_CRC,
    4: Reason.STUCK_COUNTER,
    5: Reason.JUMPED_COUNTER,
    6: Reason.INVALID_VALUE,
    7: Reason.TWIN_TIMEOUT,
    8: Reason.TWIN_MISMATCH,
    9: Reason.TWIN_TIMEOUT,
    10: Reason.TWIN_MISMATCH,
}
"""Reason of the codec for each verdict of wire.h that rejects a frame."""
