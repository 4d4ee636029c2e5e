"""What can go wrong, in the user's words: one line, and the exit code it ends with."""

from collections.abc import Callable
from typing import Any

# Of one message; the middle of longer ones is left out.
MOST_CHARACTERS = 1000


class NailopticsError(Exception):
    """An error whose message is one clear line for the user."""

    exit_code = 1


class InputError(NailopticsError):
    """The user's input is at fault: which field, which rule, which value, what to do."""

    exit_code = 2

    def __init__(self, message: str) -> None:
        # What files hold comes into messages, line breaks and endless names too.
        line = " ".join(message.splitlines())
        super().__init__(line if len(line) <= MOST_CHARACTERS else f"{line[:600]} ... {line[-300:]}")


class NotReachedError(NailopticsError):
    """A tolerance or a time limit could not be met; `result` is what was reached. On a full disk the exit code is 1."""

    exit_code = 3

    def __init__(self, message: str, *, result: object = None, full: bool = False) -> None:
        super().__init__(message)
        self.result = result
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


class WriteError(InputError):
    """A file cannot be written where the user wants it; on a full disk no input is at fault, and the exit code is 1."""

    def __init__(self, message: str, *, full: bool = False) -> None:
        super().__init__(message)
        self.exit_code = 1 if full else InputError.exit_code
