"""`riecjax simulate`: write a simulated recording."""

import json
from pathlib import Path

import click

from riecjax.cli.options import POSITIVE, json_option, seed_option, set_option
from riecjax.cli.progress import Progress
from riecjax.memory import require_memory
from riecjax.runtime import start_jax
from riecjax.standard_output import answer

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
@set_option
@click.option(
    "--duration",
    type=POSITIVE,
    help="Seconds. [default: 40, pothole 3; a file's own length]",
)
@click.option("--rate", type=POSITIVE, help="Samples per second. [default: 200; a file's own rate]")
@click.option(
    "--bandwidth",
    type=POSITIVE,
    default=30.0,
    show_default=True,
    help="Of white noise and of the Robson road, in Hz.",
)
@click.option(
    "--rms",
    type=POSITIVE,
    default=0.55,
    show_default=True,
    help="Of white noise, in the input's unit.",
)
@seed_option
@click.option(
    "--out",
    "out",
    required=True,
    type=click.Path(dir_okay=False, path_type=Path),
    help="File to write: CSV, NPZ or MAT by its ending.",
)
@json_option
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
    from riecjax.cli.drive import drive
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
