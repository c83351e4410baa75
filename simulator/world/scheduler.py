"""Virtual time: threads of which one runs at a time, chosen by one seeded generator.

Every function of `rig.host` that is replaced calls `Scheduler.step` first. A step is the only place
where time passes, another thread continues, a fault strikes, or a program dies.
"""

from __future__ import annotations

import random
import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import Any

import numba

# Time that one step takes, and how often another thread continues after it.
_STEP_NS = (1_000, 30_000)
_SWITCHES = 0.3
NEVER_NS = 2**62
# A thread that waits for so long waits for something that never happens.
_LIMIT_NS = 3600 * 1_000_000_000
_LIMIT_STEPS = 400_000


class KilledError(BaseException):
    """The program has died: its further steps have no effect."""


class StuckError(AssertionError):
    """All threads wait for something that never happens."""


class Program:
    """A running program of the world: its threads, signal handlers and exit functions.

    Parameters
    ----------
    name
        Name for the log.
    """

    def __init__(self, name: str) -> None:
        self.name = name
        self.dead = False
        self.killed = False
        self.handlers: dict[int, Any] = {signal.SIGINT: signal.default_int_handler}
        self.pending: list[int] = []
        self.at_exit: list[Callable[..., object]] = []
        self.threads: list[Task] = []
        # What the main function returned or raised; None while it runs.
        self.result: object = None
        self.error: BaseException | None = None

    def exit(self) -> None:
        """Call the exit functions."""
        while self.at_exit and not self.dead:
            self.at_exit.pop()()


class Task:
    """One thread of a program. It waits until the scheduler gives it its turn."""

    def __init__(self, program: Program, name: str, target: Callable[[], object]) -> None:
        self.program = program
        self.name = name
        self.main = not program.threads
        self.finished = False
        self.until: Callable[[], bool] | None = None
        self.deadline_ns = NEVER_NS
        self.wakes_ns: Callable[[], int] | None = None
        self.turn = threading.Lock()
        self.turn.acquire()
        self.target = target
        self.ident = 0
        program.threads.append(self)

    def ready(self, now_ns: int) -> bool:
        """Return whether the thread can continue."""
        program = self.program
        if self.until is None or program.dead or now_ns >= self.deadline_ns:
            return True
        return (self.main and bool(program.pending)) or self.until()

    def next_ns(self) -> int:
        """Return the earliest time at which the thread may continue."""
        wakes_ns = NEVER_NS if self.wakes_ns is None else self.wakes_ns()
        return min(self.deadline_ns, wakes_ns)


class Scheduler:
    """Owns time and turns.

    Parameters
    ----------
    seed
        Seed of all its choices.
    on_step
        Called with the name of each step, before it takes effect; may raise `KilledError`.
    """

    def __init__(self, seed: int, on_step: Callable[[str], None] = lambda name: None) -> None:
        self.random = random.Random(seed)
        self.now_ns = 1_000_000_000
        self.steps = 0
        self.on_step = on_step
        self.current: Task | None = None
        self.failure: BaseException | None = None
        # While the board acts, its code takes no steps.
        self.aside = False
        self.tasks: list[Task] = []
        self._outside = threading.Lock()

    @property
    def program(self) -> Program | None:
        """The program of the thread that has its turn."""
        return None if self.current is None else self.current.program

    def run(self, name: str, main: Callable[[], object]) -> Program:
        """Run a program, and all that it starts, to its end."""
        self._outside.acquire()
        program = self.start(name, main)
        self._hand_on(self._chosen())
        self._outside.acquire()
        self._outside.release()
        if self.failure is not None:
            raise self.failure
        return program

    @contextmanager
    def inside(self, name: str) -> Iterator[Program]:
        """Make the calling thread the main thread of a program in the block."""
        self._outside.acquire()
        program = Program(name)
        task = Task(program, f"{name} main", lambda: None)
        task.ident = threading.get_ident()
        self.tasks.append(task)
        self.current = task
        before = numba.get_num_threads()
        numba.set_num_threads(1)  # kernels must not start threads of their own
        try:
            yield program
        finally:
            with suppress(KilledError):
                program.exit()
            numba.set_num_threads(before)
            self._end(task)
            self._outside.acquire()
            self._outside.release()
            if self.failure is not None:
                raise self.failure

    def start(self, name: str, main: Callable[[], object]) -> Program:
        """Start a program; it gets its turn later."""
        program = Program(name)

        def whole() -> None:
            try:
                program.result = main()
            finally:
                program.exit()

        self.spawn(program, f"{name} main", whole)
        return program

    def spawn(self, program: Program, name: str, target: Callable[[], object]) -> Task:
        """Start a thread of a program."""
        task = Task(program, name, target)
        self.tasks.append(task)
        threading.Thread(target=self._live, args=(task,), name=name, daemon=True).start()
        return task

    def step(self, name: str) -> None:
        """Let time pass, and perhaps other threads continue.

        Raises
        ------
        KilledError
            If the program of this thread has died.
        """
        if self.aside:
            return
        task = self._mine()
        self._check_alive(task)
        self.steps += 1
        if self.steps > _LIMIT_STEPS:
            self._fail(StuckError(f"{self.steps} steps without an end, now: {name}"))
        self.now_ns += self.random.randint(*_STEP_NS)
        self.on_step(name)
        self._check_alive(task)
        if len(self.tasks) > 1 and self.random.random() < _SWITCHES:
            self._yield(task)
        self._deliver(task)

    def wait(
        self,
        until: Callable[[], bool],
        deadline_ns: int = NEVER_NS,
        wakes_ns: Callable[[], int] | None = None,
    ) -> bool:
        """Let other threads continue until a condition holds; return whether it does.

        Parameters
        ----------
        until
            The condition.
        deadline_ns
            When to stop waiting.
        wakes_ns
            Returns when something from outside may make it true.
        """
        task = self._mine()
        while not until() and self.now_ns < deadline_ns:
            task.until, task.deadline_ns, task.wakes_ns = until, deadline_ns, wakes_ns
            self._yield(task)
            task.until, task.deadline_ns, task.wakes_ns = None, NEVER_NS, None
            self._deliver(task)
        return until()

    def is_inside(self) -> bool:
        """Return whether this is the thread that has its turn."""
        return self.current is not None and self.current.ident == threading.get_ident()

    def kill(self, program: Program) -> None:
        """Let a program die; its threads have no effect from now on."""
        program.killed = program.killed or not program.dead
        program.dead = True

    def stall(self, seconds: float) -> None:
        """Let time pass without any step, as on a computer that is too busy."""
        self.now_ns += round(seconds * 1e9)

    def _mine(self) -> Task:
        task = self.current
        if task is None:
            raise AssertionError("a step outside the world")
        return task

    def _check_alive(self, task: Task) -> None:
        if task.program.dead:
            raise KilledError(task.program.name)

    def _deliver(self, task: Task) -> None:
        """Call the handlers of the signals that the program received, on its main thread."""
        program = task.program
        while task.main and program.pending and not program.dead:
            number = program.pending.pop(0)
            handler = program.handlers.get(number, signal.SIG_DFL)
            if callable(handler):
                handler(number, None)
            elif handler is signal.SIG_DFL:
                self.kill(program)
        self._check_alive(task)

    def _yield(self, task: Task) -> None:
        chosen = self._chosen()
        if chosen is not task:
            self._hand_on(chosen)
            task.turn.acquire()
        self._check_alive(task)

    def _chosen(self) -> Task:
        while True:
            ready = [task for task in self.tasks if task.ready(self.now_ns)]
            if ready:
                return ready[0] if len(ready) == 1 else self.random.choice(ready)
            next_ns = min(task.next_ns() for task in self.tasks)
            if next_ns >= min(NEVER_NS, self.now_ns + _LIMIT_NS):
                names = ", ".join(task.name for task in self.tasks)
                self._fail(StuckError(f"waiting forever: {names}"))
                continue
            self.now_ns = max(self.now_ns + 1, next_ns)

    def _hand_on(self, task: Task) -> None:
        self.current = task
        task.turn.release()

    def _fail(self, error: BaseException) -> None:
        """End the world with an error: all programs die."""
        self.failure = self.failure or error
        for task in self.tasks:
            task.program.dead = True

    def _live(self, task: Task) -> None:
        task.ident = threading.get_ident()
        task.turn.acquire()
        numba.set_num_threads(1)  # kernels must not start threads of their own
        program = task.program
        try:
            if not program.dead:
                task.target()
        except KilledError:
            pass
        except BaseException as error:  # noqa: BLE001 - judged by the world
            if task.main:
                program.error = error
            else:
                self._fail(error)
        self._end(task)

    def _end(self, task: Task) -> None:
        """Hand the turn on for the last time."""
        task.finished = True
        self.tasks.remove(task)
        if task.main:
            task.program.dead = True  # daemon threads end with the program
        if self.tasks:
            self._hand_on(self._chosen())
        else:
            self.current = None
            self._outside.release()


class Lock:
    """A lock of the world; as `threading.Lock`."""

    def __init__(self, scheduler: Scheduler) -> None:
        self._scheduler = scheduler
        self._held = False

    def acquire(self, blocking: bool = True, timeout: float = -1) -> bool:
        """Take the lock; return whether it was free in time."""
        self._scheduler.step("lock")
        if self._held and not blocking:
            return False
        until_ns = NEVER_NS if timeout < 0 else self._scheduler.now_ns + round(timeout * 1e9)
        if not self._scheduler.wait(lambda: not self._held, until_ns):
            return False
        self._held = True
        return True

    def release(self) -> None:
        """Free the lock."""
        self._held = False

    def locked(self) -> bool:
        """Return whether a thread holds the lock."""
        return self._held

    def __enter__(self) -> bool:
        return self.acquire()

    def __exit__(self, *_: object) -> None:
        self.release()


class Condition:
    """A condition of the world; as `threading.Condition`."""

    def __init__(self, scheduler: Scheduler) -> None:
        self._scheduler = scheduler
        self._lock = Lock(scheduler)
        self._waiting: list[list[bool]] = []

    def wait(self, timeout: float | None = None) -> bool:
        """Free the lock, wait for a notification, and take the lock again."""
        scheduler = self._scheduler
        notified = [False]
        self._waiting.append(notified)
        self._lock.release()
        until_ns = NEVER_NS if timeout is None else scheduler.now_ns + round(timeout * 1e9)
        try:
            return scheduler.wait(lambda: notified[0], until_ns)
        finally:
            if notified in self._waiting:
                self._waiting.remove(notified)
            scheduler.wait(lambda: not self._lock.locked())
            self._lock._held = True  # noqa: SLF001

    def notify_all(self) -> None:
        """Let all waiting threads continue when the lock is free."""
        for notified in self._waiting:
            notified[0] = True
        self._waiting.clear()

    def __enter__(self) -> bool:
        return self._lock.acquire()

    def __exit__(self, *_: object) -> None:
        self._lock.release()


class Thread:
    """A thread of the world; as `threading.Thread`."""

    def __init__(
        self,
        scheduler: Scheduler,
        target: Callable[..., object],
        *,
        name: str = "thread",
        args: tuple[object, ...] = (),
        daemon: bool = True,
    ) -> None:
        self._scheduler = scheduler
        self._target = target
        self._args = args
        self.name = name
        self.daemon = daemon
        self._task: Task | None = None

    def start(self) -> None:
        """Start the thread; it gets its turn later."""
        self._scheduler.step("start a thread")
        program = self._scheduler.program
        if program is None:
            raise AssertionError("a thread outside the world")
        self._task = self._scheduler.spawn(program, self.name, lambda: self._target(*self._args))

    def join(self, timeout: float | None = None) -> None:
        """Wait for the end of the thread."""
        scheduler = self._scheduler
        scheduler.step("join")
        until_ns = NEVER_NS if timeout is None else scheduler.now_ns + round(timeout * 1e9)
        scheduler.wait(lambda: not self.is_alive(), until_ns)

    def is_alive(self) -> bool:
        """Return whether the thread runs."""
        return self._task is not None and not self._task.finished


@contextmanager
def replaced(*replacements: tuple[object, str, object]) -> Iterator[None]:
    """Replace attributes of objects in the block."""
    before = [(owner, name, getattr(owner, name)) for owner, name, _ in replacements]
    try:
        for owner, name, value in replacements:
            setattr(owner, name, value)
        yield
    finally:
        for owner, name, value in before:
            setattr(owner, name, value)
