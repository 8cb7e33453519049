"""Randomness of one run: a generator of its own for every source, so that none disturbs another."""

import enum
from typing import Final

import numpy as np

BLOCK: Final = 1024
"""Numbers are drawn so many at a time; one call of a generator costs as much as a plant step."""


class NoiseSource(enum.IntEnum):
    """Everything that is drawn. A new source goes to the end: the number is part of its seed."""

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
    """The generators of one seed."""

    def __init__(self, seed: int) -> None:
        children = np.random.SeedSequence(seed).spawn(len(NoiseSource))
        self._children = dict(zip(NoiseSource, children, strict=True))

    def of(self, source: NoiseSource) -> np.random.Generator:
        """A fresh generator, which draws the same numbers each time it is asked for."""
        return np.random.Generator(np.random.PCG64(self._children[source]))


class Uniform:
    """Draws spread evenly over [low, high)."""

    __slots__ = ("_block", "_generator", "_low", "_span")

    def __init__(self, generator: np.random.Generator, *, low: float, high: float) -> None:
        self._generator = generator
        self._low = low
        self._span = high - low
        self._block: list[float] = []

    def reseed(self, generator: np.random.Generator) -> None:
        """Draw what is still to come from another generator."""
        self._generator = generator
        self._block = []

    def draw(self) -> float:
        if not self._block:
            self._block = self._generator.random(BLOCK).tolist()
            self._block.reverse()
        return self._low + self._span * self._block.pop()


class Gaussian:
    """Normal draws about zero; those beyond `clip` become `clip`."""

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
        """Draw what is still to come from another generator."""
        self._generator = generator
        self._block = []

    def draw(self) -> float:
        if not self._block:
            self._block = self._generator.standard_normal(BLOCK).tolist()
            self._block.reverse()
        value = self._sigma * self._block.pop()
        return max(-self._clip, min(self._clip, value))
