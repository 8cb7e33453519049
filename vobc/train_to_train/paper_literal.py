"""The rules of Xu, Peng and Sun (seed 003) that are unsafe, word by word, to show that they are.

No train runs by them unless it is told to by name; a test shows each of them failing.
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
"""'If there is no control vehicle in the current area, the current train is upgraded' (The
Establishment of the Control Vehicle): who hears of no master is one, and asks nobody."""

ANY_AUTHORITY_IS_SAFE: Final = dataclasses.replace(
    SAFE,
    member=without(MemberGuards(), "term_not_old", "owner_of_term", "newer_than_held"),
)
"""'Any moving authorization is safe so the controlled vehicle can run according to any' (The
Cancellation and Switching of the Control Vehicle): of two masters either is obeyed."""

RULES: Final[Mapping[str, TrainGuards]] = {
    "safe": SAFE,
    "silence-means-no-master": SILENCE_MEANS_NO_MASTER,
    "any-authority-is-safe": ANY_AUTHORITY_IS_SAFE,
}
"""By the name under which a train can be told to run by them."""
