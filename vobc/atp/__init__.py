"""Protection (ATP): where and how fast the train may be. It never leans on operation."""

from vobc.atp.config import AtpConfig, Timeouts
from vobc.atp.protection import Protection, ProtectionVerdict

__all__ = ["AtpConfig", "Protection", "Timeouts", "ProtectionVerdict"]
