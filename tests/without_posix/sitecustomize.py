"""Python without what Windows lacks; it begins every process that finds this file on its path."""

import os
import signal
import subprocess
import sys

# It takes fcntl here and msvcrt there, and would warn that it finds neither.
import filelock  # noqa: F401

# A process is ended by SIGKILL here, and by no signal there.
subprocess.Popen.kill = lambda self: self.send_signal(9)
MODULES = (
    "crypt fcntl grp nis ossaudiodev posixshmem pty pwd readline resource spwd syslog termios tty"
)
for name in MODULES.split():
    sys.modules[name] = None  # pyright: ignore[reportArgumentType]

FUNCTIONS = """
    chown chroot ctermid fchdir fchown fork forkpty getegid geteuid getgid getgroups getloadavg
    getpgid getpgrp getpriority getresuid getsid initgroups killpg lchown lockf mkfifo mknod
    nice openpty pathconf posix_fallocate posix_spawn pread pwrite readv sched_getaffinity
    sched_setaffinity sched_yield sendfile setegid seteuid setgid setpgid setpriority setsid setuid
    statvfs sync sysconf tcgetpgrp ttyname wait wait3 wait4 waitid writev
"""
for name in FUNCTIONS.split():
    if hasattr(os, name):
        delattr(os, name)
SIGNALS = """
    SIGALRM SIGCHLD SIGHUP SIGKILL SIGPIPE SIGQUIT SIGTSTP SIGUSR1 SIGUSR2 SIGWINCH
    alarm getitimer pause pthread_kill pthread_sigmask setitimer siginterrupt sigpending sigwait
"""
for name in SIGNALS.split():
    if hasattr(signal, name):
        delattr(signal, name)
