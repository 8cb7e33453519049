"""Data types of the controller: inputs and outputs of a cycle, and exchange between its parts."""

from vobc.vocabulary.inputs import (
    NEVER_S,
    Authority,
    CycleInput,
    Mission,
    OdometryRecord,
    Orders,
    PlaceProof,
    Restriction,
    TachoSample,
    TagReading,
    TrainBelief,
    cycle_input,
)
from vobc.vocabulary.motion import (
    Ceiling,
    Interval,
    Motion,
    RefusedTag,
    SupervisedTarget,
    TagRefusal,
)
from vobc.vocabulary.operation import AtoDemand, AtoInput, BrakeFinding
from vobc.vocabulary.output import (
    MAX_SERVICE_DECEL_MPS2,
    SAFE_CURRENTS,
    SAFE_OUTPUT,
    CurrentReference,
    CycleOutput,
    Event,
    Source,
)
from vobc.vocabulary.received import S_PER_NS, Received

__all__ = [
    "AtoDemand",
    "AtoInput",
    "Authority",
    "BrakeFinding",
    "Ceiling",
    "CurrentReference",
    "CycleInput",
    "CycleOutput",
    "Event",
    "Interval",
    "MAX_SERVICE_DECEL_MPS2",
    "Mission",
    "Motion",
    "NEVER_S",
    "OdometryRecord",
    "Orders",
    "PlaceProof",
    "Received",
    "RefusedTag",
    "Restriction",
    "S_PER_NS",
    "SAFE_CURRENTS",
    "SAFE_OUTPUT",
    "Source",
    "SupervisedTarget",
    "TachoSample",
    "TagReading",
    "TagRefusal",
    "TrainBelief",
    "cycle_input",
]
