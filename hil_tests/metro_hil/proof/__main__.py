"""`make fuzz`: attacks a whole controller with millions of frames, and judges every answer."""

import argparse
import functools
import sys
from collections import Counter
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from typing import Final

from firmware_py.clock.clock import WallClock
from metro_hil.proof.fuzz import KINDS, Episode, episode
from metro_hil.proof.genuine import Genuine, ride

FRAMES: Final = 10_000_000
NS_PER_S: Final = 1_000_000_000
EXIT_OK: Final = 0
EXIT_BROKEN: Final = 1
SEEDS_APART: Final = 1_000_003
"""Distance between the first seeds of two workers, so that their seeds never meet."""


def main(argv: Sequence[str] | None = None) -> int:
    """Run the attacks; return 0 if every rule held.

    Otherwise return 1 and print the first problem of each worker with the seed that repeats it.
    """
    parser = argparse.ArgumentParser(prog="fuzz", description=__doc__)
    parser.add_argument("--frames", type=int, default=FRAMES, help=f"default: {FRAMES}")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--kind", choices=sorted(set(KINDS)), help="one episode of this kind")
    options = parser.parse_args(argv)
    clock = WallClock()
    began_ns = clock.now_ns()
    if options.kind is not None:
        told = [attacked(options.kind, options.seed, options.frames)]
    else:
        share = -(-options.frames // options.jobs)
        seeds = [options.seed + SEEDS_APART * job for job in range(options.jobs)]
        with ProcessPoolExecutor(options.jobs) as pool:
            told = [e for part in pool.map(work, seeds, [share] * options.jobs) for e in part]
    return _told(told, (clock.now_ns() - began_ns) / NS_PER_S)


def attacked(kind: str, seed: int, frames_max: int) -> Episode:
    """Run one episode; a few successive seeds attack the same run."""
    return episode(_ride(seed // len(KINDS)), kind, seed, frames_max=frames_max)


@functools.lru_cache(maxsize=1)
def _ride(seed: int) -> Genuine:
    return ride(seed)


def work(seed: int, frames: int) -> list[Episode]:
    """Run episodes from `seed` on until enough frames were sent, or a problem occurred."""
    told: list[Episode] = []
    done = 0
    while done < frames and not (told and told[-1].problem):
        here = seed + len(told)
        told.append(attacked(KINDS[here % len(KINDS)], here, frames - done))
        done += told[-1].frames
    return told


def _told(told: Sequence[Episode], elapsed_s: float) -> int:
    states: Counter[str] = Counter()
    for kind in sorted({each.kind for each in told}):
        of = [each for each in told if each.kind == kind]
        states = sum((each.ended for each in of), Counter())
        print(
            f"{kind:7} {len(of):4} rides  {sum(e.frames for e in of):9} frames"
            f"  {sum(e.steps for e in of):8} steps  {dict(states)}"
        )
    frames = sum(each.frames for each in told)
    print(f"{frames} frames in {elapsed_s:.0f} s: {frames / elapsed_s:.0f} a second;", end=" ")
    print(f"{FRAMES} take {FRAMES * elapsed_s / max(1, frames) / 60:.0f} min")
    print(f"noise frames that were valid by chance, left out: {sum(e.lucky for e in told)}")
    broken = [each for each in told if each.problem]
    for each in broken:
        print(f"{each.kind}, seed {each.seed}: {each.problem}", file=sys.stderr)
        print(
            f'  repeat: make fuzz FUZZ_ARGS="--kind {each.kind} --seed {each.seed}"',
            file=sys.stderr,
        )
    return EXIT_BROKEN if broken else EXIT_OK


if __name__ == "__main__":
    sys.exit(main())
