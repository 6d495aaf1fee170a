"""Ctrl-C in the command `gtr`: handled from the start, before any heavy import, and never lost.

Python raises KeyboardInterrupt wherever the main thread happens to be. In a callback of the garbage collector
it is then lost, in the import of an extension module it becomes another error, and while XLA compiles or
computes it is delayed. Here it is raised only where that is safe, and raised again if it was lost all the
same. If the main thread does not respond, a watching thread ends the process.
"""

from __future__ import annotations

import _thread
import contextlib
import gc
import os
import signal
import socket
import sys
import threading
import time
from collections.abc import Callable, Iterator
from types import FrameType
from typing import Any

from .interpreters import is_the_command

INTERRUPTED = 130  # exit status: 128 + SIGINT, as shells have it
NOTHING_WRITTEN = "interrupted: no run folder was written"
# The signal that asks the main thread again; nothing else uses it, and by default it does nothing.
AGAIN = getattr(signal, "SIGURG", None) or signal.Signals["SIGBREAK"]
POLL = 0.05  # seconds between two checks on a pending interruption
TWICE = 0.5  # seconds within which two signals count as one: `timeout` and some shells send two
STUCK, UNWINDING = 2.0, 10.0  # seconds until the process is ended: no response, too slow a response


class Interruption:
    """What Ctrl-C does to this process. There is one instance, `interruption`.

    Attributes:
        running: whether a command is running; before that, during imports, Ctrl-C ends the process at once.
        says: the line printed when an interruption ends the process.
        undo: functions called, last first, if the process is ended at once.
    """

    def __init__(self) -> None:
        self.running = False
        self.says = NOTHING_WRITTEN
        self.undo: list[Callable[[], object]] = []
        self._ear: socket.socket | None = None
        self._asked = self._raised = 0.0  # when it was requested, and when raised; 0: never
        self._again = 0.0  # when it was last requested again
        self._held = self._patient = 0
        self._told = self._ending = False

    def install(self) -> None:
        """Handle the signal from now on, unless this process ignores it or this is not the main thread."""
        elsewhere = threading.current_thread() is not threading.main_thread()
        if self._ear is not None or elsewhere or signal.getsignal(signal.SIGINT) in (signal.SIG_IGN, None):
            return
        self._ear, mouth = socket.socketpair()
        mouth.setblocking(False)
        self._mouth = mouth  # kept open
        for number in (signal.SIGINT, AGAIN):
            signal.signal(number, self._heed)
        signal.set_wakeup_fd(mouth.fileno(), warn_on_full_buffer=False)
        before, sys.unraisablehook = sys.unraisablehook, self._lost
        self._unraisable = before
        threading.Thread(target=self._watch, name="interruption", daemon=True).start()

    @property
    def arrived(self) -> bool:
        """Whether KeyboardInterrupt was raised: a later error may be a consequence of it."""
        return self._raised > 0

    @contextlib.contextmanager
    def held(self) -> Iterator[None]:
        """Protect a block of code: an interruption waits until it is done."""
        self._held += 1
        try:
            yield
        finally:
            self._held -= 1
            if self._asked and not self._delivered():
                self._asked = time.monotonic()  # the time to respond starts here

    @contextlib.contextmanager
    def writing(self, path: object) -> Iterator[None]:
        """Write the one file that a command is for: an interruption waits until it is there, and says so."""
        with self.held():
            yield
            self.says = f"interrupted: {path} is written"

    @contextlib.contextmanager
    def patient(self) -> Iterator[None]:
        """Run code that handles KeyboardInterrupt itself, such as a fit that ends without its profiles. It
        may take as long as it needs; a second signal ends the process.
        """
        self._patient += 1
        try:
            yield
        finally:
            self._patient -= 1

    @contextlib.contextmanager
    def undoing(self, undo: Callable[[], object]) -> Iterator[None]:
        """Call `undo` if the process is ended at once within this block."""
        self.undo.append(undo)
        try:
            yield
        finally:
            self.undo.remove(undo)

    def _heed(self, number: int, frame: FrameType | None) -> None:
        now = time.monotonic()
        if number == AGAIN and not self._asked:
            return  # delivered in the meantime
        self._asked = self._asked or now
        if not self.running:
            self._end()
        if self._delivered() or self._held or not _safe(frame):
            return  # if it is not delivered, the watching thread asks again
        self._raised = now
        raise KeyboardInterrupt

    def _delivered(self) -> bool:
        return self._raised > self._asked - TWICE

    def _lost(self, unraisable: Any) -> None:
        """Note a KeyboardInterrupt that Python could not propagate; report everything else as usual."""
        if issubclass(unraisable.exc_type, KeyboardInterrupt):
            self._raised = 0.0
        else:
            self._unraisable(unraisable)

    def _watch(self) -> None:
        assert self._ear is not None
        while True:
            self._ear.settimeout(POLL if self._asked else None)
            try:
                signals = self._ear.recv(64)
            except TimeoutError:
                signals = b""
            for number in signals:
                if number == signal.SIGINT:
                    self._pressed()
            if self._asked:
                self._follow()

    def _pressed(self) -> None:
        now = time.monotonic()
        if not self._asked:
            self._asked = now
        elif now - self._asked > TWICE:
            self._end()

    def _follow(self) -> None:
        """Check on a pending interruption."""
        delivered = self._delivered()
        waited = time.monotonic() - (self._raised if delivered else self._asked)
        if delivered and self._patient:
            self._asked, self._told = 0.0, False
            return
        if waited > (UNWINDING if delivered else STUCK):
            if not self._patient:
                self._end()
            elif not self._told:
                _say("interrupting when this step is done; Ctrl-C again ends it at once")
                self._told = True
        if not delivered and time.monotonic() - self._again > POLL:
            self._again = time.monotonic()
            self._ask()

    def _ask(self) -> None:
        """Make the main thread call the handler, even while it waits."""
        main = threading.main_thread().ident
        if hasattr(signal, "pthread_kill") and main is not None:
            signal.pthread_kill(main, AGAIN)
        else:
            _thread.interrupt_main(AGAIN)

    def _end(self) -> None:
        """End the process, from any thread, unless a protected block is running (`held`)."""
        if self._held or self._ending:
            return
        self._ending = True
        for undo in reversed(self.undo):
            with contextlib.suppress(Exception):
                undo()
        _say(self.says)
        os._exit(INTERRUPTED)


def _safe(frame: FrameType | None) -> bool:
    """Whether an exception raised in this frame reaches the command unchanged."""
    swallowing = {getattr(callback, "__code__", None) for callback in gc.callbacks}
    while frame is not None:
        code = frame.f_code
        if (
            code.co_filename.startswith("<frozen importlib")
            or code.co_name == "__del__"
            or code in swallowing
        ):
            return False
        frame = frame.f_back
    return True


def _say(line: str) -> None:
    """A line on stderr, past whatever is being printed there."""
    with contextlib.suppress(OSError):
        os.write(2, f"{line}\n".encode())


interruption = Interruption()


def heed_in_the_command() -> None:
    """Handle the signal from now on if this process is the command `gtr`, which imports this first."""
    if is_the_command():
        interruption.install()
