"""Numbers that tell what this project's codec says of a frame, for modules that need no codec."""

from typing import Final

JUDGED_BUS: Final = "can_dbc"
"""The bus whose frames this project's codec can judge."""
NOT_JUDGED: Final = 0
"""Remote, error and extended frames, which no receiver of this bus takes."""
ACCEPTED: Final = 1
UNCONFIRMED: Final = 2
"""One half of a vital pair whose other half was refused or had not come by the end."""
