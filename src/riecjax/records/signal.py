"""One signal: its samples, which of them are present, its unit, and what is known of its noise.

What linear operations make of signals is arithmetic: a sum is present where all its signals are,
and its noise is the sum of theirs, source by source.

**A signal's noise** is a sum of white sources, each through the filter that made the signal:

    e_x[n] = sum_s sum_i k_xs[h + i] w_s[n - i]

with w_s white and of unit size, and k_xs the 2 h + 1 taps of a kernel in the signal's unit, the
middle one for the same sample. A sensor is a source of its own with one tap, its noise's standard
deviation. A velocity differentiated from it shares the source, and has the taps of the difference:
so covariances between signals, and between samples of one, all follow from the kernels.
"""

import dataclasses
import functools
from collections.abc import Callable, Collection, Mapping
from typing import Any

import jax
import numpy as np
from jaxtyping import Array, Bool, Float, Int
from numpy.typing import ArrayLike

from riecjax import arrays as xp
from riecjax.errors import DataError, require
from riecjax.leaves import Leaf, as_leaf

Samples = Float[np.ndarray, " n"]
Taps = Float[np.ndarray, " taps"]
DIFFERENCE_ORDER = 6
GAIN = float(np.sqrt(np.sum(np.poly([1.0] * DIFFERENCE_ORDER) ** 2)))
"""Times that white noise is as large in such differences."""
STRETCHES = 16
"""Stretches of a long signal that are looked at."""
STRETCH = 2**10
"""Samples to each of them."""
REPEATS = 3.17
"""Variance of the mean square of white noise's sixth differences, in terms of that of as many
independent squares: the sum of their squared autocorrelations, C(24, 12) / C(12, 6)^2."""
NORMAL = 0.6745
"""Median size of a standard normal variable."""
SORTED = 2**10
"""Differences whose median tells which are of noise."""
NEGLIGIBLE = 1e-6
"""Share of a kernel's energy that may be cut off with its ends."""
LONGEST_KERNEL = 4001
"""Taps, past which a kernel's ends are cut off in any case."""


class Phase(str):
    """The name of a source that is part of a sensor's noise: of one sample in so many."""

    sensor = ""


@jax.tree_util.register_dataclass
@dataclasses.dataclass(init=False, eq=False)
class SignalNoise:
    """What is known of the noise on one signal; without any source it has none.

    **Fields:**

    - `kernels`: source to taps, an odd number of them.
    - `freedom`: source to degrees of freedom of its variance, which was estimated; infinite where
      it was given.
    """

    # NumPy's numbers leave arithmetic with noise to its own.
    __array_ufunc__ = None

    kernels: dict[str, Float[Leaf, "*batch taps"]]
    freedom: dict[str, Float[Leaf, "*batch"]]

    def __init__(
        self,
        kernels: Mapping[str, Float[Leaf, "*batch taps"]] | None = None,
        freedom: Mapping[str, Float[Leaf, "*batch"]] | None = None,
    ):
        self.kernels = dict(kernels or {})
        self.freedom = {s: (freedom or {}).get(s, np.asarray(np.inf)) for s in self.kernels}

    @property
    def std(self) -> Float[Leaf, ""]:
        """Standard deviation of the noise."""
        taps = list(self.kernels.values())
        return xp.sqrt(sum((xp.sum(xp.asarray(t) ** 2, axis=-1) for t in taps), np.zeros(())))

    def is_white_of(self, sensor: str) -> bool:
        """Whether there is none but the white noise of this sensor."""
        return all(s == sensor and taps.shape[-1] == 1 for s, taps in self.kernels.items())

    def of_each(self, made: Callable[[Any], Leaf]) -> "SignalNoise":
        """The same sources through other taps, made of the kernel of each."""
        return SignalNoise({s: made(taps) for s, taps in self.kernels.items()}, self.freedom)

    def __mul__(self, factor: Any) -> "SignalNoise":
        return self.of_each(lambda taps: factor * taps)

    __rmul__ = __mul__

    def __add__(self, other: "SignalNoise") -> "SignalNoise":
        kernels = dict(self.kernels)
        for source, taps in other.kernels.items():
            kernels[source] = _sum(kernels[source], taps) if source in kernels else taps
        return SignalNoise(kernels, {**self.freedom, **other.freedom})

    def convolved(self, taps: Taps) -> "SignalNoise":
        """The noise behind a filter of an odd number of taps, centred on the same sample."""
        return self.of_each(lambda kernel: shortened(np.convolve(kernel, taps)))

    def thinned(self, count: int, wide: Collection[str]) -> "SignalNoise":
        """The noise of every `count`-th sample.

        A source of several taps becomes `count` of them, one for each of its samples that lie
        between two that stay: white each, and independent of each other.

        **Arguments:** `wide`, the sources that have several taps on any signal of the record.
        """
        if count == 1:
            return self
        kernels, freedom = {}, {}
        for source, taps in self.kernels.items():
            if source not in wide:
                kernels[source], freedom[source] = taps, self.freedom[source]
                continue
            half = taps.shape[-1] // 2
            # Of w[n count - i] with i = m count + r, the source of phase r has tap m.
            reach = -(-half // count)
            room = reach * count - half, (reach + 1) * count - half - 1
            padded = xp.pad(taps, [(0, 0)] * (taps.ndim - 1) + [room])
            apart = padded.reshape(*taps.shape[:-1], 2 * reach + 1, count)
            for phase in sorted({i % count for i in range(-half, half + 1)}):
                name = Phase(f"{source}#{phase}")
                name.sensor = getattr(source, "sensor", source)
                kernels[name], freedom[name] = apart[..., phase], self.freedom[source]
        return SignalNoise(kernels, freedom)


@jax.tree_util.register_dataclass
@dataclasses.dataclass(init=False, eq=False)
class Noise:
    """What is known of the noise on a record's signals; see the module for how it is made up.

    **Fields:**

    - `kernels`: signal to source to taps, an odd number of them. Of a signal that is not named
      nothing is known yet; one without any source has no noise.
    - `freedom`: source to degrees of freedom of its variance, which was estimated; infinite where
      it was given.
    """

    kernels: dict[str, dict[str, Float[Leaf, " taps"]]]
    freedom: dict[str, Float[Leaf, ""]]

    def __init__(
        self,
        kernels: Mapping[str, Mapping[str, Float[Leaf, " taps"]]] | None = None,
        freedom: Mapping[str, Float[Leaf, ""]] | None = None,
    ):
        self.kernels = {name: dict(sources) for name, sources in (kernels or {}).items()}
        used = sorted({source for sources in self.kernels.values() for source in sources})
        self.freedom = {source: (freedom or {}).get(source, np.asarray(np.inf)) for source in used}

    @classmethod
    def of(cls, signals: Mapping[str, SignalNoise]) -> "Noise":
        """What is known of each of these signals."""
        freedom = {s: f for noise in signals.values() for s, f in noise.freedom.items()}
        return cls({name: noise.kernels for name, noise in signals.items()}, freedom)

    def __getitem__(self, signal: str) -> SignalNoise:
        return SignalNoise(self.kernels[signal], self.freedom)

    @property
    def sources(self) -> tuple[str, ...]:
        """Names of all sources."""
        return tuple(sorted(self.freedom))

    @classmethod
    def given(
        cls,
        std: Mapping[str, ArrayLike | Array],
        correlation: Mapping[tuple[str, str], float] | None = None,
    ) -> "Noise":
        """White noise of these standard deviations, in the signals' units; 0 where there is none.

        **Arguments:** `correlation` of the noise on two signals, at the same sample: of what
        reaches both cables, or of two signals that one instrument computes.

        **Raises:** `DataError` for a standard deviation that is no number from 0 on, or for
        correlations that no noise can have.
        """
        require("the noise", std, Mapping, "{'x': 0.01}, standard deviation by signal", DataError)
        for name, value in std.items():
            level = np.asarray(value if xp.is_concrete(value) else 0.0)
            if level.dtype.kind not in "iuf" or not (np.isfinite(level) & (level >= 0)).all():
                raise DataError(
                    f"the standard deviation of the noise of '{name}' must be a number from 0 on, "
                    f"in the signal's unit; got {value}. Give 0 for a signal without noise."
                )
        names, pairs = list(std), dict(correlation or {})
        if unknown := [name for pair in pairs for name in pair if name not in std]:
            raise DataError(
                f"noise of '{unknown[0]}' is to be correlated, and has no standard deviation. "
                f"Give it one."
            )
        for (one, other), value in pairs.items():
            # A NaN equals nothing.
            if one == other or pairs.get((other, one), value) != value:
                raise DataError(
                    f"the correlation of the noise of '{one}' and '{other}' must be one number, of "
                    f"two signals; got {value}."
                )
        levels = {name: as_leaf(value) for name, value in std.items()}
        kernels = {
            n: {} if xp.is_concrete(level) and not np.any(level) else {n: level[..., None]}
            for n, level in levels.items()
        }
        joint = [name for name in names if any(name in pair for pair in pairs)]
        # What two signals share entirely leaves a zero pivot.
        matrix = (1 + 1e-12) * np.eye(len(joint))
        for pair, value in pairs.items():
            i, j = map(joint.index, pair)
            matrix[i, j] = matrix[j, i] = value
        try:
            factor = np.linalg.cholesky(matrix)
        except np.linalg.LinAlgError:
            raise DataError(
                f"no noise of {', '.join(joint)} has these correlations: they must lie between -1 "
                f"and 1, and their matrix must be positive definite."
            ) from None
        for i, name in enumerate(joint):
            shares = zip(joint[: i + 1], factor[i])
            kernels[name] = {other: (levels[name] * share)[..., None] for other, share in shares}
        return cls(kernels, {name: np.asarray(np.inf) for name in names})

    def combined(self, name: str, weights: Mapping[str, float]) -> "Noise":
        """What is known of all signals, and of a new one that is so many times each of these."""
        made = sum((weight * self[n] for n, weight in weights.items()), SignalNoise())
        return Noise({**self.kernels, name: made.kernels}, self.freedom)

    def std(self, signal: str) -> Float[Leaf, ""]:
        """Standard deviation of a signal's noise, 0 if nothing is known of it."""
        return SignalNoise(self.kernels.get(signal)).std

    def sensors(self, signal: str) -> set[str]:
        """Those whose noise a signal has, whole or in part."""
        return {getattr(source, "sensor", source) for source in self.kernels.get(signal, ())}

    def is_made_of(self, signal: str, other: str) -> bool:
        """Whether a signal's noise is all that of another signal, of which it must be made."""
        sources = set(self.kernels.get(signal, ()))
        return bool(sources) and sources <= set(self.kernels.get(other, ()))


def _sum(one: Leaf, other: Leaf) -> Leaf:
    """The sum of two kernels, by their middle taps."""
    half = max(one.shape[-1], other.shape[-1]) // 2

    def padded(taps: Leaf) -> Leaf:
        room = half - taps.shape[-1] // 2
        return xp.pad(taps, [(0, 0)] * (taps.ndim - 1) + [(room, room)])

    return padded(one) + padded(other)


def shortened(taps: Taps, negligible: float = NEGLIGIBLE) -> Taps:
    """A kernel without those ends that hold next to nothing of its energy."""
    half = taps.size // 2
    sides = taps[half + 1 :] ** 2 + taps[:half][::-1] ** 2
    beyond = np.cumsum(sides[::-1])[::-1]
    kept = min(int(np.sum(beyond > negligible * np.sum(taps**2))), LONGEST_KERNEL // 2)
    return taps[half - kept : half + kept + 1]


def stretches_of(count: int) -> Int[np.ndarray, "stretches samples"]:
    """Places of the samples that are looked at: all, of a long signal stretches, evenly spread."""
    if count <= STRETCHES * STRETCH:
        return np.arange(count)[None]
    return np.linspace(0, count - STRETCH, STRETCHES).astype(int)[:, None] + np.arange(STRETCH)


def noise_level(samples: Float[Leaf, "*batch n"]) -> Float[Leaf, "*batch"]:
    """Standard deviation of the white noise on a smooth signal.

    From its differences of sixth order: the median of their size, which steps and spikes do not
    reach, says which are of noise, and the mean square of these how large that is. Content near
    half the sampling rate counts as noise.

    **Arguments:** `samples`, NaN in gaps; no difference reaches across.
    """
    if samples.shape[-1] <= DIFFERENCE_ORDER:
        return xp.zeros(samples.shape[:-1])
    rows = xp.asarray(samples)[..., stretches_of(samples.shape[-1])]
    differences = xp.diff(rows, n=DIFFERENCE_ORDER)
    return usual_size(differences.reshape(*samples.shape[:-1], -1)) / GAIN


def usual_size(contrasts: Float[Leaf, "*batch n"]) -> Float[Leaf, "*batch"]:
    """Root mean square of those that are of noise; 0 where all are NaN."""
    sizes = xp.abs(contrasts)
    sizes = xp.where(xp.isnan(sizes).all(-1, keepdims=True), 0.0, sizes)
    # To draw a line at four standard deviations a median of some will do, and sorting all would
    # take longer than all else. Drawn at random, they miss no phase of what is periodic.
    some = sizes
    if (n := sizes.shape[-1]) > SORTED:
        some = sizes[..., _drawn(n)]
        some = xp.where(xp.isnan(some).all(-1, keepdims=True), 0.0, some)
    # Of a normal law, 6e-5 lie beyond four standard deviations, and 1e-3 of the squares' sum.
    kept = sizes <= 4 * xp.nanmedian(some, axis=-1, keepdims=True) / NORMAL
    share = xp.sum(xp.where(kept, sizes, 0.0) ** 2, -1) / xp.maximum(xp.sum(kept, -1), 1)
    return xp.sqrt(share / 0.9989)


@functools.lru_cache
def _drawn(count: int) -> Int[np.ndarray, " some"]:
    """`SORTED` of so many places, each once; the same whenever it is asked."""
    return np.random.default_rng(0).choice(count, SORTED, replace=False)


# A record has hundreds of them, which JAX takes apart faster than Equinox's modules.
@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True, eq=False)
class Signal:
    """Samples of one signal, as a [`Record`][riecjax.Record] holds them.

    A sample that is missing (a NaN in the file, a pause of the logger) holds the last value before
    it, so that every array is finite.

    **Fields:**

    - `values`: the samples, shape `(n,)`; of a batch, with its axes in front.
    - `present`: a mask, False where a sample is missing; `None` where none is.
    - `unit`: its unit, empty where it is not known.
    - `noise`: what is known of its noise; `None` where nothing is.
    """

    # NumPy's numbers and arrays leave arithmetic with signals to these.
    __array_ufunc__ = None

    values: Float[Leaf, "*batch n"]
    present: Bool[Leaf, "... n"] | None = None
    unit: str = dataclasses.field(default="", metadata={"static": True})
    noise: SignalNoise | None = None

    @classmethod
    def of(
        cls, samples: ArrayLike | Array, unit: str = "", noise: SignalNoise | None = None
    ) -> "Signal":
        """A signal of samples that are NaN where they are missing."""
        values = xp.asarray(samples)
        # Sums of small whole numbers wrap around.
        values = values.astype(float) if values.dtype.kind in "biu" else values
        present = ~xp.isnan(values)
        if not xp.is_traced(values) and present.all():
            return cls(values, None, unit, noise)
        return cls(_held(values, present), present, unit, noise)

    @property
    def with_nan(self) -> Any:
        """The samples, shape `(n,)`, NaN where they are missing; of NumPy unless traced."""
        values = xp.array(self.values, float)
        return values if self.present is None else xp.where(self.present, values, np.nan)

    def __mul__(self, factor: Any) -> "Signal":
        # Noise of another size at each sample is none that is known.
        noise = (self.noise and factor * self.noise) if np.ndim(factor) == 0 else None
        return dataclasses.replace(self, values=factor * self._array, noise=noise)

    __rmul__ = __mul__

    def __neg__(self) -> "Signal":
        return -1.0 * self

    def __add__(self, other: Any) -> "Signal":
        if not isinstance(other, Signal):
            return dataclasses.replace(self, values=_held(self._array + other, self.present))
        # Nothing known of one, nothing known of the sum.
        noise = self.noise and other.noise and self.noise + other.noise
        unit = self.unit if self.unit == other.unit else ""
        total, present = self._array + other._array, both(self.present, other.present)
        return Signal(_held(total, present), present, unit, noise)

    __radd__ = __add__

    def __sub__(self, other: Any) -> "Signal":
        return self + -1.0 * other

    def __rsub__(self, other: Any) -> "Signal":
        return -self + other

    @property
    def _array(self) -> Any:
        """The samples for arithmetic: JAX would compile it for each length."""
        return xp.asarray(self.values)


def both(one: Leaf | None, other: Leaf | None) -> Leaf | None:
    """Where both masks are True; `None` is everywhere."""
    if one is None or other is None:
        return other if one is None else one
    return xp.logical_and(one, other)


def _held(values: Any, present: Any) -> Any:
    """Samples that are not present replaced by the last before them, at the start by the first
    after, else by 0."""
    if present is None:
        return values
    last = xp.running_max(xp.where(present, np.arange(values.shape[-1]), -1))
    first = xp.argmax(present, axis=-1)[..., None]
    held = xp.take_along_axis(values, xp.where(last < 0, first, last), axis=-1)
    return xp.where(xp.any(present, axis=-1)[..., None], held, 0.0)
