"""`riecjax simulate`: write a simulated recording."""

from dataclasses import dataclass
from pathlib import Path

import click

from riecjax import settings
from riecjax.cli import Given, Progress, settings_command
from riecjax.runtime import require_memory, start_jax
from riecjax.settings import CODE, NEW_FILE, POSITIVE, TEXT, Settings, setting
from riecjax.standard_output import answer

BYTES_PER_VALUE = 50.0
"""What one value of the recording takes, to be simulated and to be written as text."""


@dataclass(frozen=True, kw_only=True)
class Simulate(Settings):
    """What is simulated."""

    model_name: str = setting("MODEL", CODE, required=True)
    source: str = setting("--input white-noise|robson|pothole|FILE", TEXT, required=True)
    """What drives the model: a kind of road, or a file with a column for each input."""
    duration: float | None = setting(
        "--duration", POSITIVE, default_in_words="40, pothole 3; a file's own length"
    )
    """Seconds."""
    rate: float | None = setting("--rate", POSITIVE, default_in_words="200; a file's own rate")
    """Samples per second."""
    bandwidth: float = setting("--bandwidth", POSITIVE, 30.0)
    """Of white noise and of the Robson road, in Hz."""
    rms: float = setting("--rms", POSITIVE, 0.55)
    """Of white noise, in the input's unit."""
    out: Path | None = setting("--out", NEW_FILE, required=True)
    """File to write: CSV, NPZ, Parquet or MAT by its ending."""


SETTINGS = (Simulate, settings.Known, settings.Seed, settings.Document)


@settings_command("simulate", *SETTINGS, short_help="Make a recording by simulation.")
def command(given: Given) -> None:
    """Simulate MODEL along an input and write the recording to a file.

    The file holds time `t` in seconds, the input, and the model's signals in SI units.
    """
    start_jax(keep_compiled=True)
    from riecjax.models.catalogue import find_model
    from riecjax.models.driving_inputs import drive
    from riecjax.records.writing import check_writable, write_record
    from riecjax.reporting.document import SCHEMA
    from riecjax.simulation.simulate import simulate

    check_writable(given.out)
    model = find_model(given.model_name)
    system = model.build_system(given.known)
    sizes = {name: given.values[name] for name in ("duration", "rate", "bandwidth", "rms", "seed")}
    with Progress():
        inputs = drive(given.source, system.input_names, **sizes)
        columns = 1 + len(inputs.arrays) + len(system.states) + len(system.outputs)
        needed = inputs.sample_count * columns * BYTES_PER_VALUE
        require_memory(f"simulating {inputs.sample_count} samples", needed, "Shorten --duration.")
        simulation = simulate(system, inputs).checked()
        record = simulation.record.select(*model.written) if model.written else simulation.record
        write_record(given.out, record)
    step, names = float(record.time_step), ["t", *record.arrays]
    if given.as_json:
        document = {"schema": SCHEMA, "model": model.name, "file": str(given.out)}
        sampling = {"columns": names, "samples": record.sample_count, "time_step": step}
        answer(document | sampling | {"seed": given.seed})
    else:
        click.echo(
            f"wrote {given.out}: {record.sample_count} samples at {1 / step:g} Hz, columns "
            f"{', '.join(names)}"
        )
