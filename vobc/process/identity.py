"""Identity of a controller: what its memory and its radio messages belong to."""

from dataclasses import dataclass, replace
from typing import Final

from firmware_py import __version__
from firmware_py.storage.nvram import NvramRecord
from firmware_py.trackdb import LineMap
from firmware_py.trackdb.version import database_version, version_of, version_text
from vobc.config import VobcConfig

NO_TRAIN: Final = 0
"""Address in a record that no controller has stored a place in."""


@dataclass(frozen=True, slots=True)
class Identity:
    """Train, line and versions. A place is valid only for the identity that it was stored by."""

    train: int
    """Radio address."""
    line: str
    database: int
    """Version of the track database."""
    parameters: int
    """Version of the vital parameters: train, odometry and protection."""
    software: str = __version__

    def stamped(self, record: NvramRecord) -> NvramRecord:
        """The record, marked as belonging to this identity."""
        return replace(
            record,
            train=self.train,
            line=self.line,
            database=self.database,
            parameters=self.parameters,
            software=self.software,
        )

    def foreign(self, record: NvramRecord) -> str:
        """Why a record belongs to another identity. Empty if it is of this one, or of none yet."""
        if record.train == NO_TRAIN and record.front_m is None:
            return ""
        if record.train != self.train:
            return f"it belongs to train {record.train}, this is train {self.train}"
        if record.line != self.line:
            return f"it belongs to line {record.line}, this is line {self.line}"
        if record.database != self.database:
            ours, theirs = version_text(self.database), version_text(record.database)
            return f"it belongs to another survey of line {self.line}: {theirs}, this is {ours}"
        if record.parameters != self.parameters:
            ours, theirs = version_text(self.parameters), version_text(record.parameters)
            return f"it belongs to other vital parameters: {theirs}, these are {ours}"
        if record.software != self.software:
            return f"software {record.software} stored it, this is {self.software}"
        return ""

    def own(self, record: NvramRecord) -> NvramRecord:
        """The record without place and wheel if these belong to another identity.

        The counts stay, as they are those of the board. The highest term stays on the same line.
        """
        if not self.foreign(record):
            return record
        term = record.highest_term if record.line == self.line else 0
        return replace(
            record, wheel_diameter_m=None, front_m=None, standing=False, highest_term=term
        )


def identity_of(config: VobcConfig, line: LineMap) -> Identity:
    """Identity of a controller with these parameters on this line."""
    vital = (config.train, config.odometry, config.atp)
    return Identity(config.address, line.name, database_version(line), version_of(vital))
