"""Ctrl-C in the command `gtr`: heeded from the first moment, before any heavy import, and never lost.

Python raises KeyboardInterrupt wherever the main thread happens to be. In a callback of the garbage collector
it is then lost, in the import of an extension module it becomes another error, and while XLA compiles or
computes it waits. Here it is raised where it is safe to raise, again where it was lost all the same; and
where the main thread does not answer, a thread of its own ends the process.
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

INTERRUPTED = 130
NOTHING_WRITTEN = "interrupted: no run folder was written"
# By this signal, which nothing else uses and which does nothing by itself, the main thread is asked again.
AGAIN = getattr(signal, "SIGURG", None) or signal.Signals["SIGBREAK"]
POLL = 0.05  # seconds between two looks at whether an interruption has arrived
TWICE = 0.5  # seconds within which two signals are one: `timeout` sends two, so does a shell to a group
STUCK, UNWINDING = 2.0, 10.0  # seconds until the process is ended: not answering, answering too slowly


class Interruption:
    """What Ctrl-C does to this process; one of a process, `interruption`.

    Attributes:
        running: whether a command runs; before, while modules are imported, the process is simply ended.
        says: the line an interruption leaves.
        undo: what is called, last first, if the process has to be ended on the spot.
    """

    def __init__(self) -> None:
        self.running = False
        self.says = NOTHING_WRITTEN
        self.undo: list[Callable[[], object]] = []
        self._ear: socket.socket | None = None
        self._asked = self._raised = 0.0  # when it was asked for, and when raised; 0 for never
        self._again = 0.0  # when it was asked for again
        self._held = self._patient = 0
        self._told = self._ending = False

    def install(self) -> None:
        """Heed the signal from now on, unless this process is to ignore it, or is not the one to say."""
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
        """Whether KeyboardInterrupt was raised: an error that follows may be what was made of it."""
        return self._raised > 0

    @contextlib.contextmanager
    def held(self) -> Iterator[None]:
        """Do something whole: an interruption waits until it is done."""
        self._held += 1
        try:
            yield
        finally:
            self._held -= 1
            if self._asked and not self._delivered():
                self._asked = time.monotonic()  # it could not be answered before

    @contextlib.contextmanager
    def patient(self) -> Iterator[None]:
        """Do what makes good use of KeyboardInterrupt itself, as a fit that ends without its profiles: wait
        for it, however long; a second signal then ends the process.
        """
        self._patient += 1
        try:
            yield
        finally:
            self._patient -= 1

    @contextlib.contextmanager
    def undoing(self, undo: Callable[[], object]) -> Iterator[None]:
        """Have something undone should the process be ended on the spot."""
        self.undo.append(undo)
        try:
            yield
        finally:
            self.undo.remove(undo)

    def _heed(self, number: int, frame: FrameType | None) -> None:
        now = time.monotonic()
        if number == AGAIN and not self._asked:
            return  # it has arrived meanwhile
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
        """Take note of a KeyboardInterrupt that got out of nowhere; all else is reported as ever."""
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
        """See how an interruption fares."""
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
        """Have the main thread call the handler, also from the midst of a wait."""
        main = threading.main_thread().ident
        if hasattr(signal, "pthread_kill") and main is not None:
            signal.pthread_kill(main, AGAIN)
        else:
            _thread.interrupt_main(AGAIN)

    def _end(self) -> None:
        """End the process, from whatever thread, unless it is in the middle of what must be done whole."""
        if self._held or self._ending:
            return
        self._ending = True
        for undo in reversed(self.undo):
            with contextlib.suppress(Exception):
                undo()
        _say(self.says)
        os._exit(INTERRUPTED)


def _safe(frame: FrameType | None) -> bool:
    """Whether an exception raised in this frame reaches the command as it is."""
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
    """Heed the signal from now on if this process is the command, which imports this package first of all."""
    script = os.path.basename(sys.argv[0]) if sys.argv else ""
    if script in ("gtr", "gtr.exe") or sys.orig_argv[1:3] == ["-m", "gtr_jax"]:
        interruption.install()
