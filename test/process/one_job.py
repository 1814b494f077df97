"""A shell with one job in its terminal: SIGUSR1 is bg, SIGUSR2 is fg.

A real shell also takes the terminal when its job is stopped by whoever stops all processes for a while.
"""
import os
import signal
import sys
import termios

if __name__ == "__main__":
    signal.signal(signal.SIGTTOU, signal.SIG_IGN)  # it takes the terminal from behind
    signal.pthread_sigmask(signal.SIG_BLOCK, (signal.SIGUSR1, signal.SIGUSR2))
    job = os.fork()
    if job == 0:
        os.setpgid(0, 0)
        os.tcsetpgrp(0, os.getpid())
        signal.signal(signal.SIGTTOU, signal.SIG_DFL)
        signal.pthread_sigmask(signal.SIG_UNBLOCK, (signal.SIGUSR1, signal.SIGUSR2))
        os.execv(sys.argv[1], sys.argv[1:])
    while True:
        asked = signal.sigwait((signal.SIGUSR1, signal.SIGUSR2))
        if asked == signal.SIGUSR1:
            os.waitpid(job, os.WUNTRACED)  # Ctrl-Z was typed
        termios.tcflush(0, termios.TCIFLUSH)  # what was typed meanwhile is nobody's
        os.tcsetpgrp(0, os.getpid() if asked == signal.SIGUSR1 else job)
        os.kill(-job, signal.SIGCONT)
        print("bg" if asked == signal.SIGUSR1 else "fg", flush=True)
