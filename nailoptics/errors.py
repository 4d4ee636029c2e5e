"""What can go wrong: a line for each fault in the user's words, and the exit code of the command.

Exit codes: 0 done; 1 an internal error, or a full disk; 2 the user's input; 3 a tolerance was not reached, or the time
limit or Ctrl-C ended the run with a result; 4 a requirement that was checked and missed; 130 interrupted without one.
"""

import os
from collections.abc import Callable, Sequence
from typing import Any, TypeVar

T = TypeVar("T")

# Of one message; the middle of longer ones is left out.
MOST_CHARACTERS = 1000


class NailopticsError(Exception):
    """An error whose message is for the user: one clear line, or one for each fault of the input."""

    exit_code = 1


class InputError(NailopticsError):
    """The user's input is at fault: which field, which rule, which value, what to do; a line for each fault."""

    exit_code = 2

    def __init__(self, *faults: str) -> None:
        # What files hold comes into messages, line breaks and endless names too.
        lines = (" ".join(fault.splitlines()) for fault in faults)
        shown = (line if len(line) <= MOST_CHARACTERS else f"{line[:600]} ... {line[-300:]}" for line in lines)
        super().__init__(*shown)

    def __str__(self) -> str:
        return "\n".join(self.args)


class NotReachedError(NailopticsError):
    """A tolerance or a time limit could not be met; `result` is what was reached. On a full disk the exit code is 1.

    interrupted : whether the user ended it.
    """

    exit_code = 3

    def __init__(self, message: str, *, result: object = None, full: bool = False, interrupted: bool = False) -> None:
        super().__init__(message)
        self.result, self.interrupted = result, interrupted
        self.exit_code = 1 if full else NotReachedError.exit_code


class RequirementError(NailopticsError):
    """A requirement on the result was checked and missed, such as that of `compare --require`."""

    exit_code = 4


def as_far_as_reached(study: Callable[..., Any], *arguments: Any, **options: Any) -> tuple[Any, NotReachedError | None]:
    """What a function returns, or what it had when it could not reach what was requested, and the reason."""
    try:
        return study(*arguments, **options), None
    except NotReachedError as error:
        if error.result is None:
            raise
        return error.result, error


def unless_cut_off(result: T, unmet: NotReachedError | str | None) -> T:
    """A result; raises NotReachedError with it where `unmet` says why it falls short, as do a Dataset's attributes."""
    if not unmet:
        return result
    if hasattr(result, "attrs"):
        result.attrs["cut_off"] = str(unmet)
    error = NotReachedError(unmet) if isinstance(unmet, str) else unmet
    error.result = result
    raise error


class WriteError(InputError):
    """A file cannot be written where the user wants it; on a full disk no input is at fault, and the exit code is 1."""

    def __init__(self, message: str, *, full: bool = False) -> None:
        super().__init__(message)
        self.exit_code = 1 if full else InputError.exit_code


def exit_message(error: BaseException, *, interrupted: bool) -> tuple[Sequence[str], int]:
    """What a command says of an error, a line for each fault, and its exit code.

    interrupted : whether Ctrl-C was pressed, of which imports and compiled code make errors of their own.

    Raises: the error itself where it is internal and NAILOPTICS_DEBUG is set.
    """
    if isinstance(error, KeyboardInterrupt) or (interrupted and not isinstance(error, NotReachedError)):
        why = str(error) if isinstance(error, KeyboardInterrupt) else ""
        return [why or "interrupted; every file that was written is complete."], 130
    if isinstance(error, NailopticsError):
        return error.args, error.exit_code
    if isinstance(error, OSError):
        return [f"{error.filename or 'the output'}: {error.strerror or error}."], 1
    if isinstance(error, MemoryError):
        return ["not enough memory; request fewer samples (touch.sample_rate_hz) or photons."], 1
    if os.environ.get("NAILOPTICS_DEBUG"):
        raise error
    return [f"internal error (please report): {type(error).__name__}: {error} (NAILOPTICS_DEBUG=1 shows where)"], 1
