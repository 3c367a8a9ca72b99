"""Settings and data for all tests."""

import contextlib
import gc
import os
from collections.abc import Iterator
from pathlib import Path

# As the command line has it, before NumPy is imported.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from riecjax.runtime import processor, start_jax

ROOT = Path(__file__).parents[1]
PRODUCTION = os.environ.get("RIECJAX_TESTS") == "production"
"""Whether to compile as users' processes do, rather than quickly."""

# What one worker, run or process of the command line has compiled, no other compiles again, single
# operations included, of which there are thousands.
os.environ.setdefault("JAX_COMPILATION_CACHE_DIR", str(ROOT / ".cache" / "compiled" / processor()))
os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0")

# Compiling is four fifths of what the tests take, and most of what they call they call once. The
# workers have all cores: to split what is compiled between threads as well only adds to it.
if not PRODUCTION:
    split = "--xla_cpu_parallel_codegen_split_count=1"
    os.environ["XLA_FLAGS"] = f"{os.environ.get('XLA_FLAGS', '')} {split}".strip()
    # Which line each operation comes from, no test asks.
    os.environ.setdefault("JAX_TRACEBACK_IN_LOCATIONS_LIMIT", "0")
start_jax()

import hypothesis  # noqa: E402
import jax  # noqa: E402
import pytest  # noqa: E402

from riecjax.findings import Finding  # noqa: E402

# The same cases in every run; new ones where a night is there to look at what they find.
hypothesis.settings.register_profile("repeated", max_examples=30, derandomize=True, deadline=None)
hypothesis.settings.register_profile("searching", deadline=None)
hypothesis.settings.load_profile("searching" if PRODUCTION else "repeated")

# Tracing makes objects by the million and few cycles: looking for these as often as Python does
# by default takes a tenth of the time.
gc.set_threshold(500_000)
# A shape that is stretched by accident is a bug; every stretch in the code is spelled out.
jax.config.update("jax_numpy_rank_promotion", "raise")

TIERS = {
    "host": "nothing is compiled by XLA in this process, which is checked",
    "compiled": "functions of the library, compiled",
    "commands": "whole commands, beside what was approved of them",
}
"""Tiers of tests in the order in which they run; `pytest -m host` takes seconds."""
HOST = ("cli/test_process.py", "test_import_direction.py", "test_import_purity.py",
        "test_structure.py", "test_whole_files.py")  # fmt: skip
"""Folders and files; `--junitxml` tells how many functions each test compiles."""
COMMANDS = ("approved", "cli")
COMPILED = "/jax/core/compile/backend_compile_duration"
"""What JAX calls the event of a compilation."""


def pytest_configure(config: pytest.Config) -> None:
    for name, meaning in TIERS.items():
        config.addinivalue_line("markers", f"{name}: {meaning}")


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """A file's place says its tier; what takes seconds comes before what takes minutes."""
    tests, order = Path(__file__).parent, list(TIERS)
    tiers = {}
    for path in {item.path for item in items}:
        place = path.relative_to(tests).as_posix() if path.is_relative_to(tests) else ""
        tiers[path] = (
            "host" if place.startswith(HOST) else "commands" if place.startswith(COMMANDS)
            else "compiled"
        )  # fmt: skip
    for item in items:
        item.add_marker(tiers[item.path])
    items.sort(key=lambda item: order.index(tiers[item.path]))


compilations = 0


def _count_compilation(event: str, duration_secs: float, **kwargs: str | int) -> None:
    global compilations
    compilations += event == COMPILED


jax.monitoring.register_event_duration_secs_listener(_count_compilation)

MOST_MAPS = 63_000
"""Memory maps of a process past which no function may be compiled; Linux allows 65530."""
MAPS_EACH = 80 if PRODUCTION else 40
"""Of a compiled function at most: of an assessment's 41 functions they are 34 on average, and 67
where they are compiled as users' processes do."""
FEWEST = 200 if PRODUCTION else 40
"""Functions of one test that there must be room for, or all are forgotten, which takes a dozen
seconds. Of the long ones of the night a discovery and a search of hidden modes need most."""
looked_at, room = 0, MOST_MAPS // MAPS_EACH


@pytest.fixture(autouse=True)
def forget_compiled_functions() -> Iterator[None]:
    """A whole suite of compiled functions runs out of memory maps, and XLA then ends the process.

    To count the maps takes as long as a small test, so that they are where they may have run out.
    """
    global looked_at, room
    yield
    maps = Path("/proc/self/maps")
    if compilations - looked_at < room - FEWEST or not maps.exists():
        return
    looked_at, room = compilations, (MOST_MAPS - maps.read_bytes().count(b"\n")) // MAPS_EACH
    if room <= FEWEST:
        jax.clear_caches()
        gc.collect()
        room = MOST_MAPS // MAPS_EACH


@contextlib.contextmanager
def in_32_bit() -> Iterator[None]:
    """JAX in single precision, and nothing that was traced before or in it is kept.

    Of a function that is traced in both, as all lambdas under `eqx.filter_jit` are, JAX 0.10 keeps
    constants in the type of the first: the other's numbers then come out as exact as that.
    """
    jax.clear_caches()
    with jax.enable_x64(False):
        yield
    jax.clear_caches()


@pytest.fixture(autouse=True)
def command_line(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """A whole command runs in an empty folder. To draw its pictures takes more than half: those
    for whom they are no matter get empty ones. Tests of charts draw them."""
    if request.path.parent.name != "cli":
        return
    monkeypatch.chdir(request.getfixturevalue("tmp_path"))
    if not request.node.get_closest_marker("draws"):
        from tests.approved.running import without_pictures

        without_pictures(monkeypatch)


@contextlib.contextmanager
def held_to(raised: set[str], absent: set[str]) -> Iterator[None]:
    """Fails unless findings of all codes `raised` are made meanwhile, and of none `absent`."""
    made: set[str] = set()
    new = Finding.__new__

    def noted(cls, code, *args, **kwargs):
        made.add(code)
        return new(cls, code, *args, **kwargs)

    Finding.__new__ = noted
    try:
        yield
    finally:
        Finding.__new__ = new
    assert raised <= made, f"no finding {sorted(raised - made)} was made, as the mark says"
    assert not absent & made, f"a finding {sorted(absent & made)} was made, against the mark"


@pytest.hookimpl(wrapper=True)
def pytest_runtest_call(item: pytest.Item) -> Iterator[None]:
    """A test that says which findings it raises, or that it raises none of some, or that it
    compiles nothing, is held to it."""
    before = compilations
    raised = {code for mark in item.iter_markers("raises_finding") for code in mark.args}
    absent = {code for mark in item.iter_markers("no_finding") for code in mark.args}
    with held_to(raised, absent) if raised | absent else contextlib.nullcontext():
        result = yield
    item.user_properties.append(("compilations", compilations - before))
    if item.get_closest_marker("host"):
        assert compilations == before, "it compiles: take it off HOST in tests/conftest.py"
    return result


def measured_data(folder: str) -> Path:
    """The folder of one measured recording; skips the test, with the reason, where it is absent."""
    root = Path(os.environ.get("RIECJAX_DATA", Path(__file__).parents[2] / "shared" / "data"))
    found = root / folder
    if not found.is_dir():
        pytest.skip(f"measured data '{folder}' is not here; set RIECJAX_DATA to its parent folder")
    return found
