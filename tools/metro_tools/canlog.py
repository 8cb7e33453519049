"""The old name of the package `canlog`, which works until release 0.3."""

import warnings

from canlog import *  # noqa: F403

warnings.warn(
    "metro_tools.canlog is now called canlog; the old name will be removed in release 0.3",
    DeprecationWarning,
    stacklevel=2,
)
