"""Runs that are broken off in every way and begun again: do they end in the same bits?"""

import contextlib
import resource
import shutil
import signal
import subprocess
import time
from pathlib import Path
from typing import Any

import numpy as np
import psutil

from benchmarks.fleet.commands import command, run

COMMANDS, DISKS = 3, 3
"""Runs of which the command is killed, or the disk is full."""
AT_ONCE = 12
"""Workers that are killed of one run, at most: each takes its time to begin anew."""
RESULTS = ("summaries.parquet", "estimates.parquet")


def breaks(folder: Path, work: Path, count: int) -> dict[str, Any]:
    """Of a fleet: so many workers killed, and the rest of what is broken off."""
    reference = work / "whole"
    seconds = run(folder, reference, 2)["seconds"]
    rng = np.random.default_rng(0)
    killed, wrong = _workers_killed(folder, work / "killed", reference, count, seconds, rng)
    found: dict[str, Any] = {"workers_killed": killed, "wrong_in": ["workers"] * wrong}
    for name, each, times in (
        ("commands_killed", _command_killed, COMMANDS),
        ("disks_full", _disk_full, DISKS),
    ):
        found[name] = 0
        for number in range(times):
            out = work / f"{name}{number}"
            done, right = each(folder, out, reference, seconds, rng)
            found[name] += done
            found["wrong_in"] += [] if right else [name]
    return found | {"wrong": len(found["wrong_in"])}


def _workers_killed(
    folder: Path, out: Path, reference: Path, count: int, seconds: float, rng: np.random.Generator
) -> tuple[int, int]:
    killed = wrong = 0
    while killed < count:
        shutil.rmtree(out, ignore_errors=True)
        process = psutil.Popen(command(folder, out, 2), stdout=subprocess.DEVNULL)
        for _ in range(AT_ONCE):
            time.sleep(rng.uniform(0.02, 0.12) * seconds)
            if process.poll() is None and killed < count and (workers := _workers(process)):
                workers[rng.integers(len(workers))].send_signal(signal.SIGKILL)
                killed += 1
        wrong += process.wait() != 0 or not _alike(out, reference)
    return killed, wrong


def _command_killed(
    folder: Path, out: Path, reference: Path, seconds: float, rng: np.random.Generator
) -> tuple[bool, bool]:
    process = psutil.Popen(command(folder, out, 2), stdout=subprocess.DEVNULL)
    time.sleep(rng.uniform(0.2, 0.7) * seconds)
    killed = process.poll() is None
    if killed:
        process.send_signal(signal.SIGKILL)
    process.wait()
    return killed, _alike_again(folder, out, reference)


def _disk_full(
    folder: Path, out: Path, reference: Path, seconds: float, rng: np.random.Generator
) -> tuple[bool, bool]:
    """No file may grow past a size that the sums need: status 1, one line, and it goes on."""
    most = int(rng.uniform(0.001, 0.9) * (reference / RESULTS[0]).stat().st_size)

    def limit() -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (most, most))

    done = subprocess.run(
        command(folder, out, 2), preexec_fn=limit, capture_output=True, text=True, check=False
    )
    last = done.stderr.strip().splitlines()[-1:]
    told = done.returncode == 1 and bool(last) and last[0].startswith("riecjax: ")
    if not told:
        print(most, done.returncode, done.stderr)
    return True, told and _alike_again(folder, out, reference)


def _workers(process: psutil.Popen) -> list[psutil.Process]:
    """Processes that sum, by what started them."""
    found = []
    for one in process.children(recursive=True):
        with contextlib.suppress(psutil.NoSuchProcess):
            if any("spawn_main" in word for word in one.cmdline()):
                found.append(one)
    return found


def _alike_again(folder: Path, out: Path, reference: Path) -> bool:
    subprocess.run(command(folder, out, 2), check=True, stdout=subprocess.DEVNULL)
    return _alike(out, reference)


def _alike(out: Path, reference: Path) -> bool:
    return all(
        (out / name).exists() and (out / name).read_bytes() == (reference / name).read_bytes()
        for name in RESULTS
    )
