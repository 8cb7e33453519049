"""Protection (ATP): supervises place and speed of the train, independently of operation (ATO)."""

from vobc.atp.config import AtpConfig, Timeouts
from vobc.atp.protection import Protection, ProtectionVerdict

__all__ = ["AtpConfig", "Protection", "Timeouts", "ProtectionVerdict"]
