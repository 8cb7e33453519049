"""Guard inputs of a running and of a standing train; tests change single fields of them."""

from can_dbc.vobc import OperatingMode, Supervision
from vobc.atp.guard_inputs import GuardInputs
from vobc.config import load_config
from vobc.vocabulary import Ceiling, Interval

CONFIG = load_config("florence4").atp
CEILING = Ceiling(10.0, 11.0, 12.0, 13.0, 500.0)
RUNNING = GuardInputs(
    CONFIG,
    speed_mps=Interval(8.8, 9.0, 9.2),
    ceiling=CEILING,
    full_mps=10.0,
    authority_age_s=0.2,
    mode=OperatingMode.AUTHORISED,
)
STANDING = RUNNING._replace(speed_mps=Interval(-0.2, 0.0, 0.2), standing=True, standstill=True)
MOVING = (Supervision.NOMINAL, Supervision.WARNING, Supervision.SERVICE)
