"""What each command compiles: functions, and seconds: `python -m benchmarks.speed compilation`.

Written to benchmarks/compilation.json; tests/cli/test_compilation.py holds the commands to it. Each
runs in a process of its own that finds nothing compiled before.
"""

import json
import subprocess
import sys
import tempfile
from pathlib import Path

from benchmarks.recorded import FOLDER, environment, write_json

FILE = FOLDER / "compilation.json"
RECORDING = "drive.csv"
COMMANDS = {
    "models": ("models",),
    "simulate": ("simulate", "quarter-car-source", "--input", "white-noise", "--out", RECORDING),
    "check": ("check", RECORDING, "--model", "quarter-car"),
    "identify": ("identify", RECORDING, "--model", "quarter-car"),
    "identify, refined": (
        *("identify", RECORDING, "--model", "quarter-car", "--refine", "output-error"),
        *("--no-sweep", "--intervals", "sandwich"),
    ),
}
"""In this order: what the second makes, the others read."""
COUNTER = """
import json, sys
from riecjax.cli.main import run
counts = {"functions": 0, "tracing_s": 0.0, "compiling_s": 0.0}
def listen(event, seconds, **_):
    if event.endswith("jaxpr_trace_duration") or event.endswith("mlir_module_duration"):
        counts["tracing_s"] += seconds
    elif event.endswith("backend_compile_duration"):
        counts["functions"] += 1
        counts["compiling_s"] += seconds
def start(*, begin, **settings):
    begin(**settings)
    import jax
    jax.monitoring.register_event_duration_secs_listener(listen)
import functools
from riecjax import runtime
runtime.start_jax = functools.partial(start, begin=runtime.start_jax)
status = run(sys.argv[1:])
counts["jax"] = "jax" in sys.modules
print(json.dumps(counts), file=sys.stderr)
sys.exit(status)
"""


def compiled_by(arguments: tuple[str, ...], folder: Path) -> dict[str, float]:
    """Functions that a command compiles, and seconds of tracing and of compiling."""
    with tempfile.TemporaryDirectory() as empty:
        command = [sys.executable, "-c", COUNTER, *arguments]
        run = subprocess.run(
            command, cwd=folder, env=environment(empty), capture_output=True, text=True, check=True
        )
    return json.loads(run.stderr.splitlines()[-1])


def main() -> None:
    found = {}
    with tempfile.TemporaryDirectory() as folder:
        for name, arguments in COMMANDS.items():
            found[name] = compiled_by(arguments, Path(folder))
            print(name, found[name], flush=True)
    write_json(FILE, found)
