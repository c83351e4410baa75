"""Processes that die at a call to the disk, forked from a server with all imports done."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from tests.forked import ForkServer

_SERVER = """
import json, os, sys

space = {}
exec(sys.argv[1], space)

def deadly(name, calls, dies_at):
    real = getattr(os, name)
    def call(*arguments, **options):
        calls[0] += 1
        if calls[0] == dies_at:
            if name == "write":
                real(arguments[0], bytes(arguments[1])[: len(arguments[1]) // 2])
            os._exit(9)
        return real(*arguments, **options)
    setattr(os, name, call)

print("ready", flush=True)
for line in sys.stdin:
    words, dies_at = json.loads(line)
    pid = os.fork()
    if pid == 0:
        calls = [0]
        for name in sys.argv[2:]:
            deadly(name, calls, dies_at)
        try:
            space["act"](*words)
        except BaseException:
            os._exit(1)
        os._exit(0)
    print(os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1]), flush=True)
"""


@contextmanager
def dying(forks: ForkServer, program: str, *names: str) -> Iterator[Callable[..., bool]]:
    """Return a function that calls ``act`` of a program in a process of its own.

    The function takes the arguments of ``act`` and the number of the call to the disk, of those
    with the given names, at which the process dies, in the middle of a write. It returns whether
    the process died; any other error of the process is an error of the test.
    """
    process = forks.start(_SERVER, program, *names)
    assert process.stdout.readline() == "ready\n"

    def died(*words: object, dies_at: int) -> bool:
        print(json.dumps([words, dies_at]), file=process.stdin, flush=True)
        code = int(process.stdout.readline())
        assert code in (0, 9)
        return code == 9

    yield died
    process.end()
