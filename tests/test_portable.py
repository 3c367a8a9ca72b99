"""The tests marked `portable` pass where there is nothing of POSIX: what .ci/portable.md runs."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

import riecjax

ROOT = Path(__file__).parents[1]
# Other libraries may leave it to the system in which encoding they read text; we may not.
STRANGERS = "ignore::EncodingWarning"
FILTERS = ("error", STRANGERS, "error::EncodingWarning:riecjax")


def without_posix(*arguments: str) -> subprocess.CompletedProcess[str]:
    """Run Python where text in no stated encoding warns, and what Windows lacks is not there."""
    path = [str(Path(__file__).with_name("without_posix")), *sys.path]
    settings = {
        "PYTHONPATH": os.pathsep.join(path),
        "PYTHONIOENCODING": "cp1252",
        "PYTHONWARNDEFAULTENCODING": "1",
        "PYTHONWARNINGS": STRANGERS,
    }
    return subprocess.run(
        [sys.executable, *arguments],
        env=os.environ | settings,
        cwd=ROOT,
        capture_output=True,
        text=True,
        encoding="cp1252",
    )


def test_nothing_of_posix_is_there():
    code = "import os, subprocess, sys\nassert not hasattr(os, 'fork')\n"
    code += "try:\n    import resource\nexcept ImportError:\n    print('gone')\n"
    assert without_posix("-c", code).stdout == "gone\n"


def test_stubs_are_plain_as_they_are_read_in_the_system_s_encoding():
    stubs = list(Path(riecjax.__file__).parent.rglob("*.pyi"))
    assert stubs
    assert [stub for stub in stubs if not stub.read_bytes().isascii()] == []


@pytest.mark.slow
def test_portable_tests_pass_without_posix(tmp_path):
    filters = "filterwarnings=" + "\n".join(FILTERS)
    options = ("-m", "portable", "-o", filters, "--basetemp", str(tmp_path / "of_it"))
    run = without_posix("-m", "pytest", "--durations=15", *options, str(ROOT / "tests"))
    assert run.returncode == 0, run.stdout + run.stderr
    passed = run.stdout.rpartition(" passed")[0].split()[-1]
    assert int(passed) > 30
    assert "skipped" not in run.stdout
