"""What drives a simulated model: noise or a road of a kind, or a recording of its inputs."""

from functools import partial
from pathlib import Path

import jax
import jax.numpy as jnp

from riecjax.errors import DataError, MissingSignalError, ModelError
from riecjax.models.quarter_car.reconstruction import ROUGHNESS, reconstructed
from riecjax.records.record import Record
from riecjax.records.recording import Aligned, only_recording
from riecjax.settings import Reading
from riecjax.simulation.inputs import band_limited_noise, pothole, robson_road

DEFAULT_RATE = 200.0
SAME_RATE = 1e-6
"""Share by which a rate may differ from a file's by rounding."""
MOST_SAMPLES = 50_000_000
DEFAULT_DURATION = {"white-noise": 40.0, "robson": 40.0, "pothole": 3.0}


def drive(
    source: str,
    input_names: tuple[str, ...],
    *,
    duration: float | None,
    rate: float | None,
    bandwidth: float,
    rms: float,
    seed: int,
) -> Record:
    """A record of the inputs `input_names`, made by a kind of excitation or read from a file.

    **Raises:** `ModelError` for an unknown kind or sizes that cannot be, `DataError` for a file
    that cannot be read or lacks an input.
    """
    if source not in DEFAULT_DURATION:
        if not Path(source).suffix and not Path(source).exists():
            raise ModelError(
                f"unknown input '{source}'; give {', '.join(DEFAULT_DURATION)} or a file."
            )
        try:
            record = only_recording(source, Reading(), lambda record, *_: Aligned(record)).record
            record = record.select(*input_names)
        except MissingSignalError as error:
            raise DataError(
                f"{source}: there is no signal '{error.signal}', which drives the model; there "
                f"are: {', '.join(error.available)}."
            ) from None
        step = float(record.time_step)
        if rate is not None and abs(rate * step - 1) > SAME_RATE:
            raise DataError(f"{source} is sampled at {1 / step:g} Hz; leave out --rate.")
        if duration is None:
            return record
        count = duration / step
        if not 1 <= count - 0.5 <= record.sample_count:
            raise DataError(f"{source} lasts {float(record.duration):g} s, not {duration:g} s.")
        return record.part(0, round(count))
    rate = DEFAULT_RATE if rate is None else rate
    samples = (DEFAULT_DURATION[source] if duration is None else duration) * rate
    if samples > MOST_SAMPLES:
        raise ModelError(f"{samples:g} samples are too many: shorten --duration or lower --rate.")
    count, step = round(samples), 1 / rate
    if source != "pothole" and bandwidth > rate / 2:
        raise ModelError(
            f"a bandwidth of {bandwidth:g} Hz needs a rate above {2 * bandwidth:g} Hz; "
            f"it is {rate:g} Hz."
        )
    hole = vars(jax.tree.map(jnp.asarray, reconstructed().pothole))
    of_kind = {
        "white-noise": partial(band_limited_noise, bandwidth=bandwidth, rms=rms),
        "robson": partial(robson_road, roughness=ROUGHNESS, bandwidth=bandwidth),
        "pothole": lambda _, *sampling: pothole(*sampling, **hole),
    }
    keys = jax.random.split(jax.random.key(seed), len(input_names))
    signals = {name: of_kind[source](key, count, step) for name, key in zip(input_names, keys)}
    if not all(bool(jnp.any(values != 0)) for values in signals.values()):
        widen = "" if source == "pothole" else " or widen --bandwidth"
        raise ModelError(f"the input is zero throughout: lengthen --duration{widen}.")
    return Record(signals, step)
