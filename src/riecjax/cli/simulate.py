"""`riecjax simulate`: write a simulated recording."""

import json
from pathlib import Path
from typing import TYPE_CHECKING

import click

from riecjax.cli import options
from riecjax.cli.progress import Progress
from riecjax.errors import DataError, MissingSignalError, ModelError
from riecjax.memory import require_memory
from riecjax.runtime import start_jax
from riecjax.standard_output import answer

if TYPE_CHECKING:
    from riecjax.records.record import Record

KINDS = ("white-noise", "robson", "pothole")
DEFAULT_RATE = 200.0
SAME_RATE = 1e-6
"""Share by which a rate may differ from a file's by rounding."""
MOST_SAMPLES = 50_000_000
DEFAULT_DURATION = {"white-noise": 40.0, "robson": 40.0, "pothole": 3.0}
BYTES_PER_VALUE = 50.0
"""What one value of the recording takes, to be simulated and to be written as text."""


@click.command("simulate", short_help="Make a recording by simulation.")
@click.argument("model_name", metavar="MODEL")
@click.option(
    "--input",
    "source",
    required=True,
    metavar="white-noise|robson|pothole|FILE",
    help="What drives the model: a kind of road, or a file with a column for each input.",
)
@options.set_option
@click.option(
    "--duration",
    type=options.POSITIVE,
    help="Seconds. [default: 40, pothole 3; a file's own length]",
)
@click.option(
    "--rate", type=options.POSITIVE, help="Samples per second. [default: 200; a file's own rate]"
)
@click.option(
    "--bandwidth",
    type=options.POSITIVE,
    default=30.0,
    show_default=True,
    help="Of white noise and of the Robson road, in Hz.",
)
@click.option(
    "--rms",
    type=options.POSITIVE,
    default=0.55,
    show_default=True,
    help="Of white noise, in the input's unit.",
)
@options.seed_option
@click.option(
    "--out",
    "out",
    required=True,
    type=click.Path(dir_okay=False, path_type=Path),
    help="File to write: CSV, NPZ or MAT by its ending.",
)
@options.json_option
def command(
    model_name: str,
    source: str,
    known: dict[str, float],
    duration: float | None,
    rate: float | None,
    bandwidth: float,
    rms: float,
    seed: int,
    out: Path,
    as_json: bool,
) -> None:
    """Simulate MODEL along an input and write the recording to a file.

    The file holds time `t` in seconds, the input, and the model's signals in SI units.
    """
    start_jax(keep_compiled=True)
    from riecjax.models.catalogue import find_model
    from riecjax.records.writing import check_writable, write_record
    from riecjax.reporting.document import SCHEMA
    from riecjax.simulation.simulate import simulate

    check_writable(out)
    model = find_model(model_name)
    system = model.build_system(known)
    with Progress():
        inputs = drive(
            source,
            system.input_names,
            duration=duration,
            rate=rate,
            bandwidth=bandwidth,
            rms=rms,
            seed=seed,
        )
        columns = 1 + len(inputs.arrays) + len(system.states) + len(system.outputs)
        needed = inputs.sample_count * columns * BYTES_PER_VALUE
        require_memory(f"simulating {inputs.sample_count} samples", needed, "Shorten --duration.")
        simulation = simulate(system, inputs).checked()
        record = simulation.record.select(*model.written) if model.written else simulation.record
        write_record(out, record)
    if as_json:
        answer(
            json.dumps(
                {
                    "schema": SCHEMA,
                    "model": model.name,
                    "file": str(out),
                    "columns": ["t", *record.arrays],
                    "samples": record.sample_count,
                    "time_step": float(record.time_step),
                    "seed": seed,
                },
                indent=2,
            )
        )
    else:
        click.echo(
            f"wrote {out}: {record.sample_count} samples at {1 / float(record.time_step):g} Hz, "
            f"columns t, {', '.join(record.arrays)}"
        )


def drive(
    source: str,
    input_names: tuple[str, ...],
    *,
    duration: float | None,
    rate: float | None,
    bandwidth: float,
    rms: float,
    seed: int,
) -> "Record":
    """A record of the inputs `input_names`, made by a kind of excitation or read from a file.

    **Raises:** `ModelError` for an unknown kind or sizes that cannot be, `DataError` for a file
    that cannot be read or lacks an input.
    """
    import jax
    import jax.numpy as jnp

    from riecjax.models.quarter_car.reconstruction import ROUGHNESS, reconstructed
    from riecjax.records.record import Record
    from riecjax.records.recording import read_record
    from riecjax.simulation.inputs import band_limited_noise, pothole, robson_road

    if source not in KINDS:
        if not Path(source).suffix and not Path(source).exists():
            raise ModelError(f"unknown input '{source}'; give {', '.join(KINDS)} or a file.")
        try:
            record = read_record(source).select(*input_names)
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
    signals = {}
    for name, key in zip(input_names, jax.random.split(jax.random.key(seed), len(input_names))):
        if source == "white-noise":
            signals[name] = band_limited_noise(key, count, step, bandwidth=bandwidth, rms=rms)
        elif source == "robson":
            signals[name] = robson_road(key, count, step, roughness=ROUGHNESS, bandwidth=bandwidth)
        else:
            hole = jax.tree.map(jnp.asarray, reconstructed().pothole)
            shape = {"depth": hole.depth, "length": hole.length, "ramp": hole.ramp}
            signals[name] = pothole(count, step, **shape)
    if not all(bool(jnp.any(values != 0)) for values in signals.values()):
        widen = "" if source == "pothole" else " or widen --bandwidth"
        raise ModelError(f"the input is zero throughout: lengthen --duration{widen}.")
    return Record(signals, step)
