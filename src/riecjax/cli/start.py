"""Where the process of the command line begins: before anything that takes long is imported.

A signal ends the process at once, whatever it is doing, with one line and the status that shells
expect. Python alone would raise an exception in the middle of anything, an import too, of which
libraries catch some and print others. So a thread waits for signals, which C tells it of, removes
what is half written, and ends the process.
"""

# `signal` itself first imports enumerations, which takes as long as all else here.
import _signal as signal  # pyright: ignore[reportMissingImports]
import os
import sys
from _thread import start_new_thread

SIGNALS = {"SIGINT": "interrupted", "SIGTERM": "terminated", "SIGHUP": "hung up"}


def main() -> None:
    """Run the command line and exit: 0 done, 1 no answer from these data, 2 wrong usage."""
    # Matrices are small here: threads wait for one another for longer than they compute.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    open_standard_streams()
    end_on_signals()
    from riecjax.cli.main import main as run

    run()


def open_standard_streams() -> None:
    """Have three, so that no file that is opened later takes the place of one that was closed.

    What is closed takes nothing: writing to it fails, as to a full disk.
    """
    for number, name in enumerate(("stdin", "stdout", "stderr")):
        if getattr(sys, name) is None:
            try:
                os.fstat(number)
            except OSError:
                # For errors there is no one to tell.
                os.open(os.devnull, os.O_WRONLY if number == 2 else os.O_RDONLY)
            mode = "w" if number else "r"
            setattr(sys, name, open(number, mode, encoding="utf-8", closefd=False))  # noqa: SIM115


def end_on_signals() -> None:
    """End the process on each of `SIGNALS` that it does not ignore, as under nohup."""
    told, tell = os.pipe()
    if hasattr(os, "set_blocking"):  # which Windows neither has nor asks for
        os.set_blocking(tell, False)
    signal.set_wakeup_fd(tell, warn_on_full_buffer=False)
    start_new_thread(_wait, (told,))
    for name in SIGNALS:
        number = getattr(signal, name, None)
        if number is not None and signal.getsignal(number) != signal.SIG_IGN:
            signal.signal(number, lambda *_: None)


def _wait(told: int) -> None:
    words = {int(getattr(signal, name, 0)): word for name, word in SIGNALS.items()}
    while (number := os.read(told, 1)[0]) not in words:
        pass
    # It may be that this is not imported yet, or in the midst of it.
    end = getattr(sys.modules.get("riecjax.whole_files"), "end", None)
    if end is not None:
        end(lambda: _end(number, words[number]))
    _end(number, words[number])


def _end(number: int, word: str) -> None:
    line = f"riecjax: {word}.\n"
    try:
        # The cursor, which a line of progress hides.
        os.write(2, f"\x1b[?25h\n{line}".encode() if os.isatty(2) else line.encode())
    finally:
        os._exit(128 + number)
