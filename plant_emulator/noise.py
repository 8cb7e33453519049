"""Random numbers of one run.

Each source has its own generator, so that no source affects another.
"""

import enum
from typing import Final

import numpy as np

BLOCK: Final = 1024
"""Random numbers are generated in blocks of this size, because one generator call costs as much as
a whole plant step."""


class NoiseSource(enum.IntEnum):
    """All sources of randomness.

    Append new sources at the end, because the number is part of the seed.
    """

    BRAKE_DEAD_TIME = 0
    BRAKE_LAG = 1
    BRAKE_GAIN = 2
    PNEUMATIC_DEAD_TIME = 3
    PNEUMATIC_GAIN = 4
    RESISTANCE = 5
    ODOMETER_SCALE = 6
    DOPPLER_SCALE = 7
    DOPPLER_NOISE = 8
    IMU_BIAS = 9
    IMU_NOISE = 10
    TAG_PLACE = 11
    TAG_TIME = 12
    TAG_LATENCY = 13
    LOOP_ERROR = 14
    LOOP_NOISE = 15
    DWELL = 16


class Generators:
    """One independent generator for each noise source, derived from one seed."""

    def __init__(self, seed: int) -> None:
        children = np.random.SeedSequence(seed).spawn(len(NoiseSource))
        self._children = dict(zip(NoiseSource, children, strict=True))

    def of(self, source: NoiseSource) -> np.random.Generator:
        """Return a fresh generator; every call with the same source gives the same sequence."""
        return np.random.Generator(np.random.PCG64(self._children[source]))


class Uniform:
    """Samples uniformly distributed over [low, high)."""

    __slots__ = ("_block", "_generator", "_low", "_span")

    def __init__(self, generator: np.random.Generator, *, low: float, high: float) -> None:
        self._generator = generator
        self._low = low
        self._span = high - low
        self._block: list[float] = []

    def reseed(self, generator: np.random.Generator) -> None:
        """Take all further samples from another generator."""
        self._generator = generator
        self._block = []

    def draw(self) -> float:
        if not self._block:
            self._block = self._generator.random(BLOCK).tolist()
            self._block.reverse()
        return self._low + self._span * self._block.pop()


class Gaussian:
    """Normally distributed samples with mean zero, limited to ±`clip`."""

    __slots__ = ("_block", "_clip", "_generator", "_sigma")

    def __init__(
        self, generator: np.random.Generator, sigma: float, clip: float = float("inf")
    ) -> None:
        assert sigma >= 0.0
        assert clip >= 0.0
        self._generator = generator
        self._sigma = sigma
        self._clip = clip
        self._block: list[float] = []

    def reseed(self, generator: np.random.Generator) -> None:
        """Take all further samples from another generator."""
        self._generator = generator
        self._block = []

    def draw(self) -> float:
        if not self._block:
            self._block = self._generator.standard_normal(BLOCK).tolist()
            self._block.reverse()
        value = self._sigma * self._block.pop()
        return max(-self._clip, min(self._clip, value))
