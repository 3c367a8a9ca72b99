import json
import subprocess
import sys

import pytest

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
