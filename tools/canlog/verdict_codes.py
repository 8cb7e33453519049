"""Codes for the verdicts of this project's codec, for modules that do not need the codec."""

from typing import Final

JUDGED_BUS: Final = "can_dbc"
"""Name of the bus whose frames this project's codec can judge."""
NOT_JUDGED: Final = 0
"""Code of remote, error and extended frames, which no receiver of this bus accepts."""
ACCEPTED: Final = 1
UNCONFIRMED: Final = 2
"""Code of one half of a vital pair whose other half was rejected or missing at the end."""
