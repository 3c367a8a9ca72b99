import json
import subprocess
import sys

import numpy as np
import pytest
from tests.machines import drag_signals

# The command line alone may make global settings, so it is not among them.
SCRIPT = """
import json, pkgutil, importlib
import jax
before = dict(jax.config.values)
import riecjax
names = []
for module in pkgutil.walk_packages(riecjax.__path__, "riecjax."):
    if module.name.split(".")[1] not in ("cli",):
        importlib.import_module(module.name)
        names.append(module.name)
for name in dir(riecjax):
    getattr(riecjax, name)
for name in riecjax.models.catalogue.LISTED:
    riecjax.find_model(name)
changed = [key for key, value in jax.config.values.items() if before.get(key) != value]
from jax._src import xla_bridge
started = list(xla_bridge._backends)
arrays = len(jax.live_arrays())
print(json.dumps(dict(names=names, changed=changed, started=started, arrays=arrays)))
"""


@pytest.fixture(scope="module")
def imported():
    run = subprocess.run([sys.executable, "-c", SCRIPT], capture_output=True, text=True)
    assert run.returncode == 0, run.stderr
    assert run.stderr == ""
    lines = run.stdout.splitlines()
    assert len(lines) == 1, "importing prints nothing"
    return json.loads(lines[0])


@pytest.mark.portable
def test_every_module_imports(imported):
    assert "riecjax.estimation.identify" in imported["names"]


def test_importing_changes_no_global_setting_of_jax(imported):
    assert imported["changed"] == []


def test_importing_and_models_create_no_array_and_start_no_backend(imported):
    assert imported["arrays"] == 0
    assert imported["started"] == []


IDENTIFY = """
import json, sys
compiled = []
from riecjax.cli.main import run
import jax
hear = lambda event, seconds, **kwargs: compiled.append(event)
jax.monitoring.register_event_duration_secs_listener(hear)
status = run(sys.argv[1:])
from jax._src import xla_bridge
print(json.dumps(dict(status=status, modules=sorted(sys.modules), compiled=compiled,
                      started=list(xla_bridge._backends))), file=sys.stderr)
"""
HEAVY = (
    *("diffrax", "optimistix", "lineax", "scipy.signal", "scipy.stats", "scipy.interpolate"),
    *("scipy.ndimage", "scipy.linalg", "pandas", "pint", "matplotlib"),
)
"""What takes as long to import as a linear answer takes."""


def test_a_linear_answer_imports_nothing_that_simulates_or_draws_and_starts_no_jax(tmp_path):
    signals = drag_signals(noise=0.01)
    columns = {"t": 0.01 * np.arange(signals["x"].size), **signals}
    lines = [
        ",".join(columns),
        *(",".join(map(repr, row)) for row in zip(*map(np.ndarray.tolist, columns.values()))),
    ]
    (tmp_path / "drag.csv").write_text("\n".join(lines))
    line = ["identify", "drag.csv", "--model", "drag-oscillator", "--refine", "none"]
    run = subprocess.run(
        [sys.executable, "-c", IDENTIFY, *line], capture_output=True, text=True, cwd=tmp_path
    )
    assert run.returncode == 0, run.stderr
    told = json.loads(run.stderr.splitlines()[-1])
    assert told["status"] == 0, run.stderr
    own = [name for name in told["modules"] if name.startswith("riecjax.")]
    assert "riecjax.validation.residuals" in own
    assert not [name for name in told["modules"] if name.split(".")[0] in HEAVY or name in HEAVY]
    rim = ("readers", "fleets", "paper", "studies", "refinement", "discovery")
    # Of discovery the library of terms, which are doubted as well.
    library = {"riecjax.discovery", "riecjax.discovery.candidate"}
    assert not [name for name in own if name.split(".")[1] in rim and name not in library]
    assert told["compiled"] == []
    assert told["started"] == []
