"""A command, in a process of its own or in this one, that gets a real Ctrl-C as it comes to a place."""

import os
import signal
import subprocess
import sys
import threading
from dataclasses import dataclass
from functools import reduce
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest

from nailoptics.cli import run

# In coarse cells, as no light is compared.
ENVIRONMENT = {"PYTHONPATH": os.pathsep.join(map(str, (Path(__file__).with_name("fewer"), Path(__file__).parents[1])))}
# At the call it waits on stdin, until the signal has come; every call is reported.
CHILD = """
import functools, importlib, sys
module, names, number, *sys.argv[1:] = sys.argv[1:]
*owners, name = names.split(".")
owner = functools.reduce(getattr, owners, importlib.import_module(module))
function, calls = getattr(owner, name), 0
def watched(*given, **options):
    global calls
    calls += 1
    print("call", calls, file=sys.stderr, flush=True)
    if calls == int(number):
        sys.stdin.readline()
    return function(*given, **options)
setattr(owner, name, watched)
from nailoptics.__main__ import main
main()
"""
# A command that has not ended by then is killed, so that no test waits for ever. [s]
DEADLINE_S = 180
STOPPING = "nailoptics: stopping after this batch; press Ctrl-C again to stop at once.\n"


@dataclass(frozen=True)
class Ended:
    """How it ended: exit code, stdout, lines of ours on stderr, and calls that began after the interrupt."""

    code: int
    out: str
    stderr_lines: list[str]
    later: int


def interrupted_at(
    place: str,
    *arguments: str,
    call: int = 1,
    twice: bool = False,
    ignored: bool = False,
) -> Ended:
    """The end of `nailoptics ARGUMENTS` that gets a SIGINT as it calls a place, MODULE:NAME, so many times.

    twice : whether another follows once the first was answered.
    ignored : whether it begins with SIGINT ignored.
    """
    module, _, name = place.partition(":")
    process = subprocess.Popen(
        [sys.executable, "-c", CHILD, module, name, str(call), *arguments],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=os.environ | ENVIRONMENT,
        preexec_fn=(lambda: signal.signal(signal.SIGINT, signal.SIG_IGN)) if ignored else None,
    )
    assert process.stdin is not None and process.stderr is not None
    deadline = threading.Timer(DEADLINE_S, process.kill)
    deadline.start()
    try:
        before = ""
        for line in process.stderr:
            before += line
            if line == f"call {call}\n":
                break
        process.send_signal(signal.SIGINT)
        if twice:
            for line in process.stderr:
                before += line
                if line == STOPPING:
                    process.send_signal(signal.SIGINT)
                    break
        out, err = process.communicate("\n")
    finally:
        deadline.cancel()
        process.kill()
    stderr_lines = [line for line in err.splitlines() if not line.startswith("call ")]
    assert "Traceback" not in before + err
    return Ended(process.returncode, out, stderr_lines, len(err.splitlines()) - len(stderr_lines))


@dataclass(frozen=True)
class Interrupting:
    """Interrupts commands of this process, which need not be loaded again: for the state of their results."""

    monkeypatch: pytest.MonkeyPatch
    capfd: pytest.CaptureFixture[str]

    def at(self, place: str, *arguments: str, call: int = 1, twice: bool = False) -> Ended:
        """As `interrupted_at`."""
        module, _, names = place.partition(":")
        *owners, name = names.split(".")
        owner: Any = reduce(getattr, owners, import_module(module))
        function, calls = getattr(owner, name), 0

        def watched(*given: Any, **options: Any) -> Any:
            nonlocal calls
            calls += 1
            if calls == call:
                for _ in range(1 + twice):
                    os.kill(os.getpid(), signal.SIGINT)
            return function(*given, **options)

        with self.monkeypatch.context() as patch:
            patch.setattr(owner, name, watched)
            code = run([*arguments])
        out, err = self.capfd.readouterr()
        assert calls >= call and "Traceback" not in err
        return Ended(code, out, err.splitlines(), calls - call)
