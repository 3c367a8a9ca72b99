"""Windows in time: where an integral criterion looks, and for how long.

**Drawing without rejection.** The paper draws T ~ U(alpha, beta) and t0 ~ U(0, t_max), and rejects
pairs with t0 + T > t_max (eqs 14-15). What is left is uniform over the trapezium of admissible
pairs, alpha <= T <= beta and 0 <= t0 <= t_max - T. A given T leaves the room r = t_max - T for t0,
so its density is proportional to r. With r_a = t_max - alpha and r_b = t_max - beta,

    P(T <= t_max - r) = (r_a^2 - r^2) / (r_a^2 - r_b^2)

Setting that to u ~ U(0, 1) gives r = sqrt(r_a^2 - u (r_a^2 - r_b^2)), then T = t_max - r and
t0 = v r with v ~ U(0, 1): two random numbers to a window, nothing rejected, fixed shapes.

**On samples** the pairs are finitely many. With lags in multiples of m samples, the lag m (k_a + j)
leaves q - m j starts, q = n - m k_a. The pairs before the j-th lag are

    P(j) = sum_{i < j} (q - m i) = j q - m j (j - 1) / 2

and pair number x belongs to the lag j with P(j) <= x < P(j + 1): the whole part of a root of a
quadratic, 4 x / (b + sqrt(b^2 - 8 m x)) with b = 2 q + m. With the root in the denominator nothing
cancels where x is small.
"""

import dataclasses
import functools
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, Self

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int, Key
from numpy.typing import ArrayLike

from riecjax import arrays as xp
from riecjax.arrays import Array
from riecjax.errors import DataError, ModelError, require
from riecjax.leaves import Leaf, PlainMethods, as_leaf
from riecjax.records.record import Record

MOST_BLOCKS = 1024
"""Blocks of starts to a record at most: more would only take memory and time."""
FEW_BLOCKS = 64
"""Blocks of starts where each must look at the whole record."""

DRAWN = 8000
"""Windows drawn where single rows of all windows are asked for."""
DEFAULT_BAND = (1.0, 10.0)
"""Lowest and highest frequency in hertz of the motion to explain, where nothing is said of it."""


def half_periods(band: tuple[float, float]) -> tuple[float, float]:
    """alpha and beta in seconds for a band in hertz: T = 1 / (2 f), eq. (26).

    **Raises:** `ModelError` unless 0 < low < high.
    """
    if not isinstance(band, tuple | list | np.ndarray | jax.Array) or len(band) != 2:
        write = "(1, 10), lowest and highest frequency in hertz: rx.RIEC.of_band((1, 10))"
        require("the band", band, (), write)
    low, high = band
    if not 0 < low < high:
        raise ModelError(f"a band needs 0 < low < high in hertz; got {low:g} to {high:g}.")
    return 1 / (2 * high), 1 / (2 * low)


class LagBins(NamedTuple):
    """Stretches of window lengths, which all count alike.

    **Fields:** `first` and `last` lag of each bin, in multiples of samples, both included; empty
    where `last < first`.
    """

    first: Int[Leaf, " bins"]
    last: Int[Leaf, " bins"]


class WindowSet(NamedTuple):
    """Start and end of each window, counted in samples: integers on the grid, or real numbers."""

    start: Int[Array, " windows"] | Float[Array, " windows"]
    stop: Int[Array, " windows"] | Float[Array, " windows"]


class AbstractWindows(PlainMethods, eqx.Module):
    """Windows from alpha to beta seconds long, at any place in a record.

    To see the most of a motion of frequency f, T = 1 / (2 f) (eq. 26), so choose half a period
    of the fastest (alpha) and of the slowest mode (beta) that the model should have.
    """

    alpha: Leaf
    beta: Leaf

    def check(self, record: Record, multiple: int) -> None:
        """Raise `DataError` if the record is too short or too coarse (not under jit)."""
        if not xp.is_concrete(self.alpha, self.beta, record.time_step):
            return
        step, beta = float(record.time_step), float(self.beta)
        duration = step * (record.sample_count - 1)
        if beta > duration * (1 + 1e-12):
            raise DataError(
                f"the longest window, beta = {beta:g} s, is longer than the record, "
                f"{duration:g} s. Choose a smaller beta or record for longer."
            )
        if beta < multiple * step:
            samples = "one sample" if multiple == 1 else f"{multiple} samples"
            raise DataError(
                f"the longest window, beta = {beta:g} s, is shorter than {samples}, "
                f"{multiple * step:g} s. Choose longer windows; or is the record's time in "
                f"milliseconds (on the command line: --scale t=0.001), or its time step a rate?"
            )

    def lags(self, record: Record, multiple: int = 1) -> tuple[Int[Array, ""], Int[Array, ""]]:
        """Shortest and longest window in multiples of samples, at least 1, within the record.

        **Raises:** `ModelError` when it is differentiated by alpha or beta.
        """
        band = self.alpha, self.beta
        alpha, beta = band if xp.is_concrete(band) else _rounded_away(band)
        unit, most = xp.multiply(multiple, record.time_step), (record.sample_count - 1) // multiple
        shortest = xp.clip(xp.divide(alpha, unit), 1, most)
        longest = xp.clip(xp.divide(beta, unit), shortest, most)
        return xp.round(shortest).astype(np.int32), xp.round(longest).astype(np.int32)

    @property
    def drawn(self) -> "RandomWindows":
        """Random windows of these lengths, for what needs single rows: these, or so many."""
        if isinstance(self, RandomWindows):
            return self
        return RandomWindows(self.alpha, self.beta, DRAWN)

    @property
    def every(self) -> "AllWindows":
        """All windows of these lengths: these, or what they converge to as their number grows."""
        return self if isinstance(self, AllWindows) else AllWindows(self.alpha, self.beta)

    def fitted(self, records: Sequence[Record]) -> Self:
        """The same windows with what the records tell before tracing."""
        return self

    def between(self, alpha: Float[Array, ""] | float, beta: Float[Array, ""] | float) -> Self:
        """The same windows with other lengths."""
        return dataclasses.replace(self, alpha=as_leaf(alpha), beta=as_leaf(beta))

    def describe(self) -> dict[str, object]:
        """Settings, for tables and JSON."""
        return {"alpha": np.asarray(self.alpha).tolist(), "beta": np.asarray(self.beta).tolist()}


@jax.custom_jvp
def _rounded_away(band: tuple[Leaf, Leaf]) -> tuple[Leaf, Leaf]:
    return band


@_rounded_away.defjvp
def _rounded_away_jvp(primals: Any, tangents: Any) -> Any:
    raise ModelError(
        "these windows have no derivative by alpha or beta: their lengths are rounded to samples. "
        "Differentiate RandomWindows(..., between_samples=True) with Boxcar(), or hold alpha and "
        "beta by jax.lax.stop_gradient."
    )


def _band(alpha: float | Leaf, beta: float | Leaf) -> tuple[Leaf, Leaf]:
    """The shortest and the longest window in seconds, each one number.

    **Raises:** `ModelError` for anything else, and unless 0 < alpha < beta.
    """
    for name, value in (("alpha", alpha), ("beta", beta)):
        if isinstance(value, str) or value is None or np.ndim(value):
            write = "rx.AllWindows(0.05, 0.5), with the shortest and the longest window in seconds"
            require(name, value, (), write)
    if xp.is_concrete(alpha, beta) and not 0 < float(alpha) < float(beta):
        raise ModelError(
            f"windows need 0 < alpha < beta; got alpha = {float(alpha):g} s and "
            f"beta = {float(beta):g} s."
        )
    return as_leaf(alpha), as_leaf(beta)


class AllWindows(AbstractWindows):
    """Every window on samples, from alpha to beta, all equally likely as in eq. (14).

    What random windows converge to as their number grows: the same estimate without the scatter of
    a draw, in closed form (see `all_windows`). The cost does not depend on how many there are.

    Alpha and beta are rounded to samples, so that nothing can be differentiated by them.

    **Arguments:**

    - `alpha`, `beta`: shortest and longest window in seconds.
    - `longest_samples`: an upper limit to beta in samples, which sets the size of the blocks that
      the record is worked through in. Known where beta is a plain number; under `jit` or
      `vmap` over beta it should be given, or every block spans the record.

    **Raises:** `ModelError` unless 0 < alpha < beta; when it is differentiated by alpha or beta.
    """

    longest_samples: int | None = eqx.field(static=True)

    def __init__(
        self, alpha: float | Leaf, beta: float | Leaf, *, longest_samples: int | None = None
    ):
        self.alpha, self.beta = _band(alpha, beta)
        self.longest_samples = longest_samples

    def fitted(self, records: Sequence[Record]) -> Self:
        """The same windows with `longest_samples` determined, if that is possible.

        A power of two, so that blocks of starts divide evenly.
        """
        steps = [record.time_step for record in records]
        if self.longest_samples is not None or not xp.is_concrete(self.beta, steps):
            return self
        samples = max(float(self.beta) / float(step) for step in steps)
        limit = power_of_two(samples + 2)
        return dataclasses.replace(self, longest_samples=limit)

    def between(self, alpha: Float[Array, ""] | float, beta: Float[Array, ""] | float) -> Self:
        """The same windows with other lengths.

        An upper limit that was determined for shorter ones is dropped, or it would cut longer ones.
        """
        longer = xp.is_concrete(beta, self.beta) and float(beta) > float(self.beta)
        limit = None if longer else self.longest_samples
        return dataclasses.replace(super().between(alpha, beta), longest_samples=limit)

    def reach(self, sample_count: int) -> int:
        """No window is longer, in samples."""
        return sample_count if self.longest_samples is None else self.longest_samples

    def block(self, sample_count: int) -> int:
        """Starts to a block: no fewer than the longest window has samples, and a power of two.

        Shorter blocks would have more overlap than starts to work through. Of an unknown longest
        window every block spans the record, and there are few.
        """
        if self.longest_samples is None:
            wanted = power_of_two(sample_count / FEW_BLOCKS)
        else:
            wanted = max(self.longest_samples, power_of_two(sample_count / MOST_BLOCKS))
        return min(wanted, -(-sample_count // 2))

    def describe(self) -> dict[str, object]:
        """Settings, for tables and JSON."""
        return {**super().describe(), "windows": "all"}


class RandomWindows(AbstractWindows):
    """The paper's random windows: T ~ U(alpha, beta), t0 ~ U(0, t_max), t0 + T <= t_max.

    Eqs (14)-(15), drawn without rejection; the module derives how.

    **Arguments:**

    - `alpha`, `beta`: shortest and longest window in seconds.
    - `count`: number of windows.
    - `between_samples`: draw start and length from the continuum, and interpolate the record
      between its samples, instead of rounding both to samples. The default, on samples, is
      faster, and its expectation is a finite sum over pairs of samples.

    **Raises:** `ModelError` unless 0 < alpha < beta and count >= 1; when it is differentiated by
    alpha or beta on samples.
    """

    count: int = eqx.field(static=True)
    between_samples: bool = eqx.field(static=True)

    def __init__(
        self, alpha: float | Leaf, beta: float | Leaf, count: int, *, between_samples: bool = False
    ):
        self.alpha, self.beta = _band(alpha, beta)
        require(
            "the number of windows",
            count,
            (int, np.integer),
            "a whole number, rx.RandomWindows(0.05, 0.5, 8000)",
        )
        self.count = count
        self.between_samples = between_samples
        if count < 1:
            raise ModelError(f"the number of windows must be at least 1; got {count}.")

    def describe(self) -> dict[str, object]:
        """Settings, for tables and JSON."""
        between = {"between_samples": True} if self.between_samples else {}
        return {**super().describe(), "windows": self.count, **between}

    def draw(self, key: Key[Array, ""], record: Record, multiple: int = 1) -> WindowSet:
        """`count` windows of a record; on samples, lengths are multiples of so many."""
        u, v = xp.on_host(jax.random.uniform(key, (2, self.count)))
        sample_count, m = record.sample_count, multiple
        if self.between_samples:
            last = sample_count - 1.0
            room_a, room_b = (last - ends / record.time_step for ends in (self.alpha, self.beta))
            room = xp.sqrt(room_a**2 - u * (room_a**2 - room_b**2))
            start = v * room
            return WindowSet(start, xp.minimum(start + (last - room), last))
        shortest, longest = self.lags(record, m)
        # In real numbers: of ten minutes at 10 kHz, 32-bit integers do not hold the pairs.
        lag_count = (longest - shortest + 1).astype(u.dtype)
        most = (sample_count - m * shortest).astype(u.dtype)
        pair = u * (lag_count * most - m * lag_count * (lag_count - 1) / 2)
        b = 2.0 * most + m
        j = 4 * pair / (b + xp.sqrt(b**2 - 8 * m * pair))
        lag = m * (shortest + xp.clip(j.astype(np.int32), 0, longest - shortest))
        start = xp.minimum((v * (sample_count - lag)).astype(np.int32), sample_count - lag - 1)
        return WindowSet(start, start + lag)


def power_of_two(value: float) -> int:
    """The least power of two, 2 at least, that is no smaller."""
    return 2 ** int(np.ceil(np.log2(max(value, 2))))


# Blocks of starts; and long records chunk by chunk, so that memory does not grow with them.

CHUNK = 2**14
"""Samples to a chunk: large beside a window, and its columns fit into a processor's cache."""
WHOLE = 2**17
"""Samples up to which a record is not cut, so that expressions may look at all of it."""
WHOLE_32_BIT = 2**14
"""The same in 32-bit, where running integrals over more samples would lose digits."""


def chunk_length(record: Record, block: int, reach: int) -> int:
    """Starts to a chunk, a whole number of blocks; the whole record if it is not much longer."""
    uncut = WHOLE if record.time_step.dtype == np.float64 else WHOLE_32_BIT
    if record.sample_count <= max(uncut, 4 * reach):
        return record.sample_count
    return -(-max(CHUNK, 4 * reach) // block) * block


class StartBlocks(NamedTuple):
    """Blocks of starts, one after the other.

    **Fields:** `first` sample at which the first block begins; `size`, starts to a block; `number`
    of blocks.
    """

    first: Int[Array, ""] | int
    size: int
    number: int

    def cut(self, values: Float[Array, "columns n"], width: int) -> Float[Array, "b columns w"]:
        """Each block and what follows it, so many samples from its first one on; zero beyond the
        last sample."""
        size, number = self.size, self.number
        room = max(number * size, (number - 1) * size + width)
        if not xp.are_traced(values, self.first):
            part = values[:, self.first : self.first + room]
            if part.shape[1] < room:  # a tenth of what `np.pad` takes
                behind = np.zeros((part.shape[0], room - part.shape[1]), part.dtype)
                part = np.concatenate([part, behind], axis=1)
            every = np.lib.stride_tricks.sliding_window_view(part, width, axis=1)
            return np.swapaxes(every[:, : number * size : size], 0, 1)
        # Room behind, so that no slice would begin earlier than asked for.
        padded = jnp.pad(values, ((0, 0), (0, room)))
        return jax.vmap(lambda at: xp.cut(padded, at, width))(self.first + size * np.arange(number))

    def products(
        self, left: Float[Array, "a n"], right: Float[Array, "b n"]
    ) -> Float[Array, "blocks a b"]:
        """sum_u left[u] right[u]^T by blocks; what lies beyond counts to the last one."""
        n = left.shape[1]
        # As many blocks of the same size as the samples could fill.
        every = self._replace(number=max(-(-n // self.size), self.number))
        sums = xp.products(*(every.cut(each, self.size) for each in (left, right)))
        beyond = sums[self.number - 1 :].sum(axis=0, keepdims=True)
        return xp.concatenate([sums[: self.number - 1], beyond])


def in_chunks(
    record: Record,
    blocks: StartBlocks,
    of_chunk: Callable[[Record, StartBlocks, Any], Any],
    *,
    reach: int,
    margin: int,
    length: int,
    beside: Any = (),
) -> Any:
    """What `of_chunk` makes of each chunk of a record, stacked along a leading axis.

    **Arguments:**

    - `of_chunk`: takes a stretch of the record, the blocks of starts in it, and the sample that the
      stretch begins at. The last chunk may have blocks beyond those asked for.
    - `reach`: samples that a window reaches beyond its start at most; `margin`: samples more on
      either side, for quadrature.
    - `length`: starts to a chunk; `beside`, what `of_chunk` closes over.
    """
    n, size, count = record.sample_count, blocks.size, blocks.number
    width = length + reach + 2 * margin
    if width >= n - blocks.first:
        return jax.tree.map(lambda leaf: leaf[None], of_chunk(record, blocks, 0))

    def one(index: Array) -> Any:
        start = blocks.first + index * length
        begin = xp.clip(start - margin, 0, n - width)
        part = record.stretch(begin, width)
        return of_chunk(part, StartBlocks(start - begin, size, length // size), begin)

    return xp.each(one, np.arange(-(-count * size // length)), beside=(record, beside))


def sum_over_bins(
    bins: LagBins,
    of_bin: Callable[[LagBins], Any],
    made: Callable[[Any], Any] = lambda total: total,
    *,
    beside: Any,
) -> Any:
    """What is made of the sum over all bins of a law; a bin without a lag adds nothing, in no time.
    Of a law that is itself in bins the same of each, along a leading axis.

    Of a single bin without a loop, which would be run for each equation: what several equations
    have in common is then computed once.

    **Arguments:** `beside`, what `of_bin` and `made` close over.
    """
    first = LagBins(*(leaf[0] for leaf in bins))
    if bins.first.ndim > 1:

        def of_law(law: LagBins) -> Any:
            return sum_over_bins(law, of_bin, made, beside=beside)

        if bins.first.shape[0] == 1:
            return jax.tree.map(lambda leaf: leaf[None], of_law(first))
        return xp.each(of_law, bins, beside=beside)
    if not xp.are_traced(bins, beside):
        held = [bin_ for bin_ in map(LagBins._make, zip(*bins)) if bin_.first <= bin_.last]
        if not held:
            return made(jax.tree.map(np.zeros_like, of_bin(first)))
        return made(functools.reduce(functools.partial(jax.tree.map, np.add), map(of_bin, held)))
    if bins.first.shape[0] == 1:
        return made(of_bin(first))
    shapes = jax.eval_shape(of_bin, first)
    nothing = jax.tree.map(lambda leaf: jnp.zeros(leaf.shape, leaf.dtype), shapes)

    def add(total: Any, bin_: LagBins) -> tuple[Any, None]:
        added = jax.lax.cond(bin_.first <= bin_.last, of_bin, lambda _: nothing, bin_)
        return jax.tree.map(jnp.add, total, added), None

    # In reverse mode each bin is computed again: storing all would take bins x columns x samples.
    return made(jax.lax.scan(jax.checkpoint(add), nothing, LagBins(*map(jnp.asarray, bins)))[0])


# Bins of window lengths whose sums are kept apart, so that a band can be chosen afterwards.


MOST_BINS = 2**10
"""Bins of window lengths: memory grows with each, and neighbours hardly differ."""


class LengthBins(NamedTuple):
    """Stretches of window lengths in seconds, among whose edges are alpha and beta.

    **Fields:** `edges`, ascending, shape `(bins + 1,)`; `band`, first bin from alpha on and first
    one beyond beta.
    """

    edges: Float[np.ndarray, " bins+1"]
    band: tuple[int, int]

    @classmethod
    def of(cls, alpha: float, beta: float, bins: int | ArrayLike) -> "LengthBins":
        """So many bins from alpha to beta, in equal ratios; or with these edges, in seconds, and
        with alpha and beta.

        **Raises:** `ModelError` for fewer than one, for too many, and unless edges are positive
        and finite.
        """
        edges = None
        if isinstance(bins, int | np.integer):
            number = int(bins)
            if number < 1:
                raise ModelError(f"there must be one bin of window lengths at least; got {number}.")
        else:
            edges = np.asarray(bins, float).ravel()
            number = edges.size - 1
            if not (np.isfinite(edges).all() and (edges > 0).all()):
                raise ModelError("edges of bins of window lengths are positive numbers of seconds.")
        if number > MOST_BINS:
            raise ModelError(
                f"sums of {number} bins of window lengths would take too much memory: give at most "
                f"{MOST_BINS}, bins=12 as a rule."
            )
        edges = np.geomspace(alpha, beta, number + 1) if edges is None else edges
        # Edges that are alpha or beta but for rounding would make bins of nothing.
        near = np.isclose(edges, alpha, rtol=1e-9) | np.isclose(edges, beta, rtol=1e-9)
        every = np.unique([*edges[~near], alpha, beta])
        first, last = np.searchsorted(every, [alpha, beta])
        return cls(every, (int(first), int(last)))

    def lags(
        self, unit: float, most: int
    ) -> tuple[Int[np.ndarray, " bins"], Int[np.ndarray, " bins"]]:
        """First and last lag of each bin, in multiples of samples of `unit` seconds.

        The band's ends both belong to it, so that bins below it hold their lower edge and those
        above their upper one. None is longer than `most`; empty where `last < first`.
        """
        edges = np.maximum(np.round(self.edges / unit), 1).astype(int)
        bins = np.arange(edges.size - 1)
        start, _ = self.band
        first = edges[:-1] + (bins > start)
        last = edges[1:] - (bins < start)
        return first, np.minimum(last, most)

    def nearest(self, alpha: float, beta: float) -> tuple[int, int]:
        """The bins, first and one beyond the last, whose edges are nearest in ratio to a band's.

        **Raises:** `ModelError` unless 0 < alpha < beta.
        """
        if not 0 < alpha < beta:
            raise ModelError(f"a band needs 0 < alpha < beta; got {alpha:g} to {beta:g} s.")
        first, last = (
            int(np.argmin(np.abs(np.log(self.edges / length)))) for length in (alpha, beta)
        )
        if first == last:
            # Of one bin at least: the one that holds the middle of the band.
            middle = np.searchsorted(self.edges, np.sqrt(alpha * beta)) - 1
            first = int(np.clip(middle, 0, self.edges.size - 2))
            last = first + 1
        return first, last


def law_in_bins(law: LagBins, bins: LengthBins, unit: float, most: int) -> LagBins:
    """A law of lags, cut into bins: two axes, bins and what each holds of the law."""
    low, high = (ends[:, None] for ends in bins.lags(unit, most))
    at, law = np.arange(low.size)[:, None], LagBins(*map(np.asarray, law))
    inside = (bins.band[0] <= at) & (at < bins.band[1])
    begin = np.where(inside, np.maximum(law.first, low), low)
    end = np.where(inside, np.minimum(law.last, high), high)
    # Beyond the band the law's first entry has all of a bin.
    held = (begin <= end) & (inside | (np.arange(law.first.size) == 0))
    dtype = law.first.dtype
    return LagBins(np.where(held, begin, 1).astype(dtype), np.where(held, end, 0).astype(dtype))
