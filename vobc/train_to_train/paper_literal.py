"""The unsafe rules of [Xu], taken literally, to show by test that they are unsafe.

A train runs by one of them only if a run names it. A test shows each of them failing.
"""

import dataclasses
from collections.abc import Mapping
from typing import Final

from vobc.train_to_train.guards import LeaseGuards, MasterGuards, MemberGuards, TrainGuards, without

SAFE: Final = TrainGuards()

SILENCE_MEANS_NO_MASTER: Final = dataclasses.replace(
    SAFE,
    lease=without(LeaseGuards(), "granted_by_majority", "lease_runs"),
    master=without(MasterGuards(), "roster_kept"),
)
"""'If there is no control vehicle in the current area, the current train is upgraded' ([Xu], The
Establishment of the Control Vehicle). A train that receives nothing from a master becomes master
without asking the arbiters."""

ANY_AUTHORITY_IS_SAFE: Final = dataclasses.replace(
    SAFE,
    member=without(MemberGuards(), "term_not_old", "owner_of_term", "newer_than_held"),
)
"""'Any moving authorization is safe so the controlled vehicle can run according to any' ([Xu], The
Cancellation and Switching of the Control Vehicle). A train obeys either of two masters."""

RULES: Final[Mapping[str, TrainGuards]] = {
    "safe": SAFE,
    "silence-means-no-master": SILENCE_MEANS_NO_MASTER,
    "any-authority-is-safe": ANY_AUTHORITY_IS_SAFE,
}
"""Guard sets by the name that selects them on the command line."""
